"""A run folder holds all that a run needs: it can be moved, and its model's file may go."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import ExperimentError
from testbed.experiment.run_folder import check_folder, read_run, write_recorded, write_run
from testbed.robot.visuals.load_shapes import load_shapes

CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 4 3\nf 1 2 4\nf 2 3 4\n"
INERTIA = '<inertial mass="2" pos="0.1 0 0.2" diaginertia="0.1 0.2 0.15"/>'
MJCF = f"""<mujoco model="one"><compiler meshdir="../shapes"/>
<include file="parts/assets.xml"/><worldbody><body name="arm">{INERTIA}
<joint name="j" axis="0 1 0" range="-90 90"/><geom type="mesh" mesh="cube"/></body></worldbody>
</mujoco>"""
ASSETS = '<mujoco><asset><mesh name="cube" file="cube.obj"/></asset></mujoco>'
URDF = """<robot name="one"><link name="base"/><link name="arm">
<inertial><origin xyz="0.1 0 0.2"/><mass value="2"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.15"/></inertial>
<visual><geometry><mesh filename="package://maker/shapes/cube.obj"/></geometry></visual></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-1.5" upper="1.5" effort="100" velocity="2"/></joint></robot>"""


def written(folder: Path, language: str) -> Path:
    """A model with a mesh, an include or a package, in folders of their own."""
    home = folder / "maker/models"
    (home / "parts").mkdir(parents=True)
    (folder / "maker/shapes").mkdir()
    (folder / "maker/shapes/cube.obj").write_text(CUBE)
    (home / "parts/assets.xml").write_text(ASSETS)
    path = home / f"one.{language}"
    path.write_text(MJCF if language == "xml" else URDF)
    return path


def experiment(folder: Path, language: str, name: str = "one") -> tb.Experiment:
    model = written(folder, language)
    path = folder / "e.toml"
    path.write_text(
        f'name = "{name}"\nmodel = "{model.relative_to(folder)}"\n[motion]\nduration = 3.0\n'
        "candidates = 1\n[measurement]\nrate = 200.0\n[simulation]\nbandwidth = 30.0\n"
    )
    return tb.Experiment.load(path)


@pytest.mark.slow
@pytest.mark.parametrize("language", ["xml", "urdf"])
def test_a_run_folder_can_be_moved_and_its_model_may_go(language: str, tmp_path: Path) -> None:
    asked = experiment(tmp_path / "here", language)
    run = tb.carry_out(asked)
    looks = load_shapes(asked.model, run.tree)
    assert any(shape.kind == "mesh" for shape in looks.shapes)
    write_run(run, tmp_path / "run")
    shutil.rmtree(tmp_path / "here")
    (tmp_path / "run").rename(tmp_path / "there")
    again = read_run(tmp_path / "there")
    for method, estimate in run.estimates.items():
        np.testing.assert_array_equal(again.estimates[method].values, estimate.values)
    assert again.experiment is not None
    found = load_shapes(again.experiment.model, again.tree)
    assert found.warnings == looks.warnings == ()
    for one, other in zip(found.shapes, looks.shapes, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
    path = tmp_path / "there/experiment.toml"
    np.testing.assert_array_equal(
        tb.simulate(tb.Experiment.load(path)).measured("wrench"), run.recording.measured("wrench")
    )


def test_what_a_model_names_besides_shapes_and_models_is_not_taken_along(tmp_path: Path) -> None:
    asked = experiment(tmp_path / "here", "urdf")
    secret = tmp_path / "here/maker/shapes/key.txt"
    secret.write_text("secret")
    model = Path(asked.model)
    model.write_text(model.read_text().replace("cube.obj", "key.txt"))
    write_recorded(asked, tb.simulate(asked), tmp_path / "run")
    assert not list((tmp_path / "run").rglob("key.txt"))


def test_an_older_run_goes_only_for_the_same_experiment_or_by_force(tmp_path: Path) -> None:
    asked = experiment(tmp_path / "here", "urdf")
    write_recorded(asked, tb.simulate(asked), tmp_path / "run")
    check_folder(tmp_path / "run", asked)
    other = asked.model_copy(update={"seed": 4})
    with pytest.raises(ExperimentError, match="--force"):
        check_folder(tmp_path / "run", other)
    check_folder(tmp_path / "run", other, force=True)
    (tmp_path / "run/notes.txt").write_text("mine")
    with pytest.raises(ExperimentError, match=r"holds notes\.txt"):
        check_folder(tmp_path / "run", asked, force=True)


def test_a_run_without_a_result_is_read_all_the_same(tmp_path: Path) -> None:
    """As it stands where the identification was interrupted."""
    asked = experiment(tmp_path / "here", "xml")
    write_recorded(asked, tb.simulate(asked), tmp_path / "run")
    assert not (tmp_path / "run/result.json").exists()
    assert set(read_run(tmp_path / "run").estimates) == {"external", "internal"}
