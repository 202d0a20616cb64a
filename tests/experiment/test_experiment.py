"""Experiment files: every key is checked and named, overrides go where they belong, rates fit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

import pytest
from pydantic import BaseModel

import testbed as tb
from testbed.core.base.errors import ExperimentError, SettingsError, TestbedError
from testbed.core.base.toml_text import LARGEST_FILE, override
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_robot import robot_of
from testbed.lab.experiment.results import default_folder
from testbed.lab.experiment.robot_tables import JointTable
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses

TABLE6 = ROOT / "experiments/table6.toml"


def test_what_ships_is_readable_and_makes_a_claim() -> None:
    for path in sorted((ROOT / "experiments").glob("*.toml")):
        experiment = tb.Experiment.load(path)
        assert experiment.claim
        assert experiment.expect
        assert Path(experiment.model).is_file()


def test_settings_override_keys_and_the_resolved_file_says_the_same(tmp_path: Path) -> None:
    words = ["motion.duration=7", "measurement.torque_constant_error.elbow=-0.01", "name=other"]
    experiment = tb.Experiment.load(TABLE6, words)
    assert (experiment.motion.duration, experiment.name) == (7, "other")
    assert experiment.measurement.torque_constant_error["elbow"] == -0.01
    assert experiment.measurement.torque_constant_error["waist"] == 0.08
    (tmp_path / "again.toml").write_text(experiment.as_toml())
    again = tb.Experiment.load(tmp_path / "again.toml")
    assert again == experiment
    assert default_folder(again) == default_folder(experiment)
    assert default_folder(experiment.model_copy(update={"seed": 5})) != default_folder(experiment)
    content: dict[str, Any] = {}
    override(content, ['robot.lock."arm.elbow"=0.5', "robot.'a.b'.c='x'", "motion.duration=3"])
    quoted = {"lock": {"arm.elbow": 0.5}, "a.b": {"c": "x"}}
    assert content == {"robot": quoted, "motion": {"duration": 3}}


def test_what_is_not_understood_is_named() -> None:
    for setting, *culprits in (
        ("motion.duraton=7", "[motion]", "'duraton'", "'duration'"),
        ("duration=3", "'duration'", "motion.duration"),
        ("expect={internal_rms_relative_error={}}", "at_most"),
        (f"motion.duration={'w' * 500}", "motion.duration", "w" * 50),
        ("motion.harmonics=2.5", "motion.harmonics"),
        (f"motion.duration={'9' * 5000}", "motion.duration"),
        ("name=../up", "name"),
        ("motion.duration", "motion.duration"),
        ("name.first=1", "'name'"),
        ('motion.file="a\\u0000b"', "motion.file"),
    ):
        with refuses(ExperimentError, *culprits):
            tb.Experiment.load(TABLE6, [setting])
    with pytest.raises(ExperimentError) as caught:  # all faults at once
        tb.Experiment.load(TABLE6, ["motion.duration=-1", "speed=1", "seed=-4"])
    assert all(word in str(caught.value) for word in ("duration", "speed", "seed"))


def is_number(kind: Any) -> bool:
    """Whether a key takes a number with a fraction, and perhaps something else."""
    lists = (dict, list, tuple)
    return kind is float or (get_origin(kind) not in lists and any(map(is_number, get_args(kind))))


def numbers_of(table: type[BaseModel], path: str = "") -> Iterator[str]:
    """Paths of all keys of numbers in a table and those within it."""
    for name, field in table.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from numbers_of(kind, f"{path}{name}.")
        elif is_number(kind):
            yield f"{path}{name}"


def test_no_number_is_infinite() -> None:
    """Whatever key is added: a motion without end, or noise without end, would be simulated."""
    paths = [*numbers_of(Experiment), *numbers_of(JointTable, "robot.joint.waist.")]
    assert len(paths) > 10
    for k, path in enumerate(paths):
        with refuses(ExperimentError, path):
            tb.Experiment.load(TABLE6, [f"{path}={('inf', '-inf', 'nan')[k % 3]}"])


def test_files_that_would_cost_memory_or_the_stack_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "e.toml"
    size = TABLE6.stat().st_size
    whole = TABLE6.read_text() + "#" * (LARGEST_FILE - size)
    path.write_text(whole)
    assert tb.Experiment.load(path, [f"model='{ROOT / 'models/puma562.xml'}'"]).name == "table6"
    for text in (
        whole + "#",
        f"a = {'[' * 100_000}",
        ".".join("a" * 50_000) + " = 1\n",
        f"seed = {'9' * 5000}\n",
    ):
        path.write_text(text)
        with refuses(ExperimentError, "e.toml"):
            tb.Experiment.load(path)


def test_what_does_not_fit_the_robot_or_the_clock_is_refused() -> None:
    for word, culprit in (
        ("measurement.torque_constant_error.wrist=0.1", "'wrist'"),
        ("motion.max_velocity.wrist=0.1", "'wrist'"),
        ('robot.base="measured"', "robot.base"),
    ):
        with refuses(TestbedError, culprit):
            robot_of(tb.Experiment.load(TABLE6, [word]))
    for word in ("bandwidth=1e6", "step=1e-320", "step=3e-4"):
        with refuses(SettingsError, word.partition("=")[0]):
            tb.record(tb.Experiment.load(TABLE6, [f"simulation.{word}"]))
    with refuses(ExperimentError, "fundamental"):
        tb.record(tb.Experiment.load(TABLE6, ["motion.fundamental=1e-12"]))
