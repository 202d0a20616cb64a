"""Gravity is given by numbers or by words, everywhere alike; torques do not show all rotations."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from hypothesis import given

import testbed as tb
from testbed.cli.options import GravityVector, join_gravity_words
from testbed.core.base.errors import ExperimentError, SettingsError
from testbed.core.base.toml_text import validate_tables
from testbed.core.dynamics.gravity_rotations import gravity_rotation_diagnostic
from testbed.core.robot.gravity import GRAVITY_BY_MOUNTING
from testbed.importing.mapping import Mapping
from testbed.lab.experiment.experiment import Experiment
from tests.helpers.command import command_line
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.runs import robot
from tests.helpers.strategies import few, rngs, trees

MODEL = ROOT / "models/puma562.xml"
SIGNALS = {
    "position": {"source": "log", "columns": ["q"], "unit": "rad"},
    "torque": {"source": "log", "columns": ["tau"], "unit": "N m"},
}


def mapping(gravity: Any) -> Any:
    """Gravity as a mapping file keeps it."""
    log = {"file": "log.csv", "rate": 100.0}
    said = {"rate": 100.0, "joints": ["a"], "sources": {"log": log}, **SIGNALS}
    return validate_tables(Mapping, {**said, "gravity": gravity}, "map.toml").gravity


@pytest.mark.parametrize("word", GRAVITY_BY_MOUNTING)
def test_words_are_numbers_in_python_commands_experiments_and_mappings(word: str) -> None:
    wanted = GRAVITY_BY_MOUNTING[word]
    assert np.linalg.norm(wanted) in (0.0, 9.81)
    np.testing.assert_array_equal(robot("puma").with_gravity(word).gravity, wanted)
    assert [*GravityVector.parse(word)] == mapping(word) == mapping(wanted) == wanted
    assert Experiment.of_model(MODEL, [f"gravity={word}"]).gravity == wanted
    numbers = " ".join(map(str, wanted))
    for text in (numbers, numbers.replace(" ", ",")):
        assert [*GravityVector.parse(text)] == wanted
    for words in (word, numbers):
        line = ["minimal", "r.urdf", "--gravity", *words.split(), "--json"]
        assert join_gravity_words(line) == ["minimal", "r.urdf", "--gravity", words, "--json"]


@pytest.mark.parametrize("text", ["", "walls", "wall", "wall +z", "0 0", "0 0 0 0", "0,0,down"])
def test_other_texts_are_refused_with_the_words_that_are_known(text: str) -> None:
    with refuses(SettingsError, *GRAVITY_BY_MOUNTING):
        robot("puma").with_gravity(text)
    with refuses(ExperimentError, "map.toml", "gravity", *GRAVITY_BY_MOUNTING):
        mapping(text)
    with refuses(ExperimentError, "gravity", *GRAVITY_BY_MOUNTING):
        Experiment.of_model(MODEL, [f'gravity="{text}"'])
    with refuses(typer.BadParameter, *GRAVITY_BY_MOUNTING):
        GravityVector.parse(text)


def test_the_option_goes_before_the_file_and_before_the_recording(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text(
        f'name = "e"\nmodel = "{MODEL}"\ngravity = "ceiling"\n'
        "[motion]\nduration = 4.0\n[measurement]\nrate = 200.0\n"
    )
    line = ("simulate", "e.toml", "--out", "r.parquet", "--gravity", "wall", "-y")
    assert command_line(*line, cwd=tmp_path).returncode == 0
    known = tb.Recording.load(tmp_path / "r.parquet").metadata.gravity
    assert known == tuple(GRAVITY_BY_MOUNTING["wall -y"])
    for command in ("excite", "run"):
        done = command_line(command, "e.toml", "--gravity", "up", cwd=tmp_path)
        assert done.returncode == 2
        assert "'up' is no gravity" in done.stderr
    shown = ("report", "r.parquet", "--model", str(MODEL), "--gravity", "level")
    assert command_line(*shown, cwd=tmp_path).returncode == 0
    assert '"gravity": "0 0 -9.81 m/s^2"' in (tmp_path / "r.json").read_text()


def hidden(tree: tb.Tree, gravity: Any) -> dict[str, str]:
    """What does the same as a rotation of gravity, by its axis."""
    minimal = tb.minimal_set(tree, "torque", gravity)
    said = gravity_rotation_diagnostic(tree, minimal).text
    return dict(re.findall(r"(\S+ \S+ \S+) \(([^)]*)\)", said))


@few(20)
@given(tree=trees((1, 6)), rng=rngs)
def test_rotations_about_gravity_and_about_the_only_first_axis_do_not_show(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """Of a pendulum that feels gravity none does: another centre of mass does the same."""
    gravity = 5 * rng.normal(size=3)
    axes = np.array([axis.split() for axis in hidden(tree, gravity)], dtype=float).T
    first, *others = (joint for joint in tree.joints if joint.parent < 0)
    basis = np.linalg.qr(axes)[0]
    for axis in (gravity, *([first.rotation @ first.axis] if first.revolute else [])):
        if axis is gravity or not others:
            left = axis - basis @ (basis.T @ axis)
            assert np.linalg.norm(left) < 1e-3 * np.linalg.norm(axis)
    assert axes.shape[1] == 3 or tree.n > 1 or not first.revolute


def test_what_does_the_same_as_a_rotation_of_gravity_is_named(tmp_path: Path) -> None:
    nothing, waist = "changes nothing", "as another zero of 'waist'"
    for text, wanted in {
        "level": {"0 0 1": nothing},
        "ceiling": {"0 0 1": nothing},
        "wall -x": {"1 0 0": nothing, "0 0 1": waist},
        "wall +y": {"0 1 0": nothing, "0 0 1": waist},
        "3 4 5": {"0 0 1": waist, "0.6 0.8 0": waist},
    }.items():
        assert hidden(robot("puma"), text) == wanted
    for words, known in ((("wall", "-x"), True), (("none",), False), (("0", "0", "0"), False)):
        done = command_line("minimal", str(MODEL), "--gravity", *words, cwd=tmp_path)
        said = " ".join(done.stdout.split())
        assert (f"1 0 0 ({nothing}), 0 0 1 ({waist})" in said) == known
        assert ("rotation of gravity" in said) == known
