"""An experiment file for any robot is what the reader of such files takes, and says what is so."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import InertiaError, TestbedError
from testbed.excitation.limits import limits_of
from testbed.experiment.assumptions import DRY
from testbed.experiment.evaluate import robot_of
from testbed.experiment.motions import motion_of
from testbed.experiment.new_experiment import new_experiment
from testbed.robot.load import nearest_bodies
from tests.helpers.paths import GOLDEN, REAL, ROOT
from tests.helpers.runs import MODELS


def written(model: Path, folder: Path) -> tb.Experiment:
    file = folder / "new.toml"
    file.write_text(new_experiment(model, folder, tried=False), encoding="utf-8")
    return tb.Experiment.load(file)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(MODELS))
def test_what_it_says_is_the_model_s(name: str, tmp_path: Path) -> None:
    experiment = written(MODELS[name], tmp_path)
    assert Path(experiment.model) == MODELS[name].resolve()
    tree, own = robot_of(experiment), tb.load_tree(MODELS[name])
    text = (tmp_path / "new.toml").read_text()
    for model in ("dynamic", "reaction"):
        assert re.search(rf"\b{tb.minimal_set(own, model).count}\b", text.splitlines()[0])
    limits = limits_of(own)
    assert experiment.motion.max_velocity == pytest.approx(
        dict(zip(own.names, limits.velocity, strict=True)), rel=1e-5
    )
    for joint, before in zip(tree.joints, own.joints, strict=True):
        assert joint.coulomb > 0 or joint.viscous > 0  # a robot without friction is no test
        if before.coulomb or before.viscous:
            assert (joint.coulomb, joint.viscous) == (before.coulomb, before.viscous)
    motion_of(experiment, tree)  # proven


def test_every_default_that_it_shows_is_one(tmp_path: Path) -> None:
    """Lines in comments are taken as they stand: the experiment stays the same."""
    text = new_experiment(MODELS["puma"], tmp_path, tried=False)
    (tmp_path / "new.toml").write_text(text)
    shown = text.replace("# gravity", "gravity")
    (tmp_path / "shown.toml").write_text(shown)
    as_is, with_shown = (tb.Experiment.load(tmp_path / f"{n}.toml") for n in ("new", "shown"))
    np.testing.assert_allclose(robot_of(as_is).gravity, robot_of(with_shown).gravity)
    for line in text.splitlines():
        if line.startswith("# external") or line.startswith("# internal"):
            tomllib.loads(line[2:])


def test_joints_of_any_name_and_roots_that_float(tmp_path: Path) -> None:
    (tmp_path / "odd.xml").write_text("""<mujoco><worldbody><body name="b"><freejoint/>
      <geom size=".1"/><body name="c" pos="0 0 .2">
      <joint name="a b.&quot;c&quot; = 0" axis="0 1 0"/>
      <geom size=".1" pos=".1 0 .1"/></body></body></worldbody></mujoco>""")
    experiment = written(tmp_path / "odd.xml", tmp_path)
    assert experiment.weld_root
    tree = robot_of(experiment)
    assert tree.names == ('a b."c" = 0',)
    assert tree.joints[0].coulomb > 0


def test_followers_are_held(tmp_path: Path) -> None:
    text = MODELS["gantry"].read_text()
    tree = tb.load_tree(MODELS["gantry"])
    last, first = tree.names[-1], tree.names[0]
    k = text.index(f'name="{last}"')
    head = text.index(">", k) + 1
    (tmp_path / "mimic.urdf").write_text(f'{text[:head]}<mimic joint="{first}"/>{text[head:]}')
    experiment = written(tmp_path / "mimic.urdf", tmp_path)
    assert experiment.robot.lock_mimic
    assert robot_of(experiment).n == tree.n - 1


def test_what_is_no_robot_is_refused(tmp_path: Path) -> None:
    for name, text in (("no.urdf", "<robot/>"), ("no.txt", "hello")):
        (tmp_path / name).write_text(text)
        with pytest.raises(TestbedError):
            new_experiment(tmp_path / name, tmp_path)


def test_golden_robots_have_one(tmp_path: Path) -> None:
    for file in sorted((GOLDEN / "robots").glob("*.urdf"))[:6]:
        experiment = written(file, tmp_path)
        assert set(experiment.motion.max_acceleration) == set(robot_of(experiment).names)


FOLLOWER = """<link name="counterweight"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="parallel" type="revolute"><parent link="link1"/><child link="counterweight"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="2"/>
<mimic joint="shoulder" multiplier="-1"/></joint></robot>"""


def test_grippers_are_held_with_their_fingers_and_arms_are_not(tmp_path: Path) -> None:
    panda = written(REAL / "panda_description/urdf/panda.urdf", tmp_path)
    assert panda.robot.lock == {"panda_finger_joint1": 0.0}
    assert robot_of(panda).n == 7
    text = (ROOT / "models/puma562.urdf").read_text().replace("</robot>", FOLLOWER)
    (tmp_path / "arm.urdf").write_text(text)
    arm = written(tmp_path / "arm.urdf", tmp_path)
    assert arm.robot.lock == {}  # the shoulder is followed, and carries the elbow
    assert robot_of(arm).names == ("waist", "shoulder", "elbow")


def test_bodies_that_cannot_be_are_written_as_they_will_be_taken(tmp_path: Path) -> None:
    """To the last digits; every word of them is also told, the first few by name."""
    path = REAL / "icub_description/robots/icub_reduced.urdf"
    said: list[str] = []
    (tmp_path / "new.toml").write_text(new_experiment(path, tmp_path, tried=False, say=said.append))
    experiment = tb.Experiment.load(tmp_path / "new.toml")
    found = nearest_bodies(path, weld_root=experiment.weld_root)
    assert set(experiment.robot.repair) == set(found.bodies)
    assert len(found.bodies) == len(found.flaws) > 3
    assert sum("link '" in line for line in said) == 3
    assert f"and {len(found.bodies) - 3} more" in said[-1]
    tree, own = robot_of(experiment), tb.load_tree(path, weld_root=experiment.weld_root)
    for a, b in zip(tree.inertias, own.inertias, strict=True):
        np.testing.assert_allclose(a.pseudo, b.pseudo, rtol=1e-12, atol=1e-15)
    (tmp_path / "again.toml").write_text(experiment.as_toml())
    again = tb.Experiment.load(tmp_path / "again.toml").robot.bodies
    for name, body in experiment.robot.bodies.items():
        np.testing.assert_array_equal(again[name].pseudo, body.pseudo)
    bare = experiment.model_copy(
        update={"robot": experiment.robot.model_copy(update={"repair": {}})}
    )
    with pytest.raises(InertiaError, match="`testbed new`"):
        robot_of(bare)
    with pytest.raises(InertiaError):
        new_experiment(path, tmp_path, strict=True)


def test_repaired_links_may_have_any_name(tmp_path: Path) -> None:
    name = 'l (1) = "a.b"'
    (
        tmp_path / "odd.xml"
    ).write_text(f"""<mujoco><worldbody><body name='{name.replace('"', "&quot;")}'>
      <joint axis="0 1 0"/><inertial mass="1" pos=".1 0 0" diaginertia="1 1 9"/></body>
      </worldbody></mujoco>""")
    experiment = written(tmp_path / "odd.xml", tmp_path)
    assert list(experiment.robot.repair) == [name]
    assert robot_of(experiment).inertias[0].mass == 1.0


def test_a_robot_without_mass_is_no_experiment(tmp_path: Path) -> None:
    text = '<robot><link name="a"/><link name="b"/><joint name="j" type="continuous">'
    path = tmp_path / "r.urdf"
    path.write_text(f'{text}<parent link="a"/><child link="b"/></joint></robot>')
    with pytest.raises(TestbedError, match="no link that moves has a mass"):
        new_experiment(path, tmp_path)


def test_friction_is_assumed_from_the_load_of_postures_within_the_whole_range(
    tmp_path: Path,
) -> None:
    """Of a light pendulum between 0 and 1 rad the rms of m g l sin q is 0.522 m g l."""
    mass, arm = 100.0, 0.01
    (tmp_path / "pendulum.urdf").write_text(f"""<robot name="pendulum"><link name="base"/>
      <link name="bob"><inertial><origin xyz="0 0 {-arm}"/><mass value="{mass}"/>
      <inertia ixx="1e-6" ixy="0" ixz="0" iyy="1e-6" iyz="0" izz="1e-6"/></inertial></link>
      <joint name="swing" type="revolute"><parent link="base"/><child link="bob"/>
      <axis xyz="0 1 0"/><limit lower="0" upper="1" effort="1000" velocity="1"/></joint></robot>""")
    experiment = written(tmp_path / "pendulum.urdf", tmp_path)
    load = mass * 9.81 * arm * np.sqrt(0.5 - np.sin(2.0) / 4)
    assert robot_of(experiment).joints[0].coulomb == pytest.approx(DRY * load, rel=0.1)


def test_assumed_errors_of_torque_constants_alternate(tmp_path: Path) -> None:
    for name in MODELS:
        said = written(MODELS[name], tmp_path).measurement.torque_constant_error
        gains = np.array(list(said.values()))
        np.testing.assert_array_equal(np.sign(gains), [(-1) ** k for k in range(len(gains))])


def test_a_run_is_named_for_the_robot_where_the_file_says_nothing(tmp_path: Path) -> None:
    text = (ROOT / "models/puma562.xml").read_text()
    for name, wanted in (("robot", "puma562"), ("mine", "mine")):
        model = tmp_path / f"{name}.xml"
        model.write_text(text)
        assert written(model, tmp_path).name == wanted
