"""Experiments: every key checked, overrides, verdicts, run folders."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

import pytest
from pydantic import BaseModel, ValidationError

import testbed as tb
from testbed.errors import ExperimentError
from testbed.experiment.experiment import ExperimentTables, RecordingTables
from testbed.experiment.experiment_tables import ALWAYS_JUDGED, Bound, JointTable
from testbed.experiment.run_folder import default_folder, write_run
from testbed.toml_text import LARGEST_FILE, checked, override
from tests.helpers.paths import ROOT

TABLE6 = ROOT / "experiments/table6.toml"
QUICK = ("motion.duration=4", "simulation.step=5e-4", "motion.candidates=2")


@pytest.fixture(scope="module")
def quick() -> tb.Experiment:
    return tb.Experiment.load(TABLE6, QUICK)


EXPERIMENTS = [
    path
    for path in sorted((ROOT / "experiments").glob("*.toml"))
    if "variant" not in tomllib.loads(path.read_text())
]
"""The others are comparisons: test_comparison.py reads them."""


@pytest.mark.parametrize("path", EXPERIMENTS)
def test_every_experiment_in_the_house_is_readable_and_makes_a_claim(path: Path) -> None:
    experiment = tb.Experiment.load(path)
    assert experiment.claim
    assert experiment.expect
    assert Path(experiment.model).is_file()


def test_settings_override_keys_of_the_file() -> None:
    settings = ["motion.duration=7", "measurement.torque_constant_error.elbow=-0.01", "name=other"]
    experiment = tb.Experiment.load(TABLE6, settings)
    assert experiment.motion.duration == 7
    assert experiment.measurement.torque_constant_error["elbow"] == -0.01
    assert experiment.measurement.torque_constant_error["waist"] == 0.08
    assert experiment.name == "other"


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("motion.duraton=7", "unknown key in [motion] 'duraton'; did you mean 'duration'?"),
        ("speed=1", "unknown key 'speed'"),
        ("expect.external_rms.at_most=1", "known: external_rms_relative_error"),
        ("motion.duration=-1", "motion.duration"),
        ("motion.duration=fast", "found 'fast'"),
        ("motion.harmonics=2.5", "motion.harmonics"),
        ("seed=-1", "seed"),
        ("name=../up", "name"),
        ("motion.duration", "write it as table.key=value"),
        ("name.first=1", "'name' is a value, not a table"),
        ("measurement.force_noise=nan", "measurement.force_noise"),
        ("identification.cutoff=none", "identification.cutoff"),
    ],
)
def test_what_is_not_understood_is_named(setting: str, said: str) -> None:
    with pytest.raises(ExperimentError) as caught:
        tb.Experiment.load(TABLE6, [setting])
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


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


NUMBERS = [*numbers_of(ExperimentTables), *numbers_of(JointTable, "robot.joint.waist.")]


@pytest.mark.parametrize("path", NUMBERS)
def test_no_number_is_infinite(path: str) -> None:
    for value in ("inf", "-inf", "nan"):
        with pytest.raises(ExperimentError, match=re.escape(path)):
            tb.Experiment.load(TABLE6, [f"{path}={value}"])


@pytest.mark.parametrize(("length", "cut"), [(58, False), (59, True)])
def test_what_was_found_is_shown_whole_unless_it_is_long(length: int, cut: bool) -> None:
    """Sixty characters of it, quotation marks among them."""
    with pytest.raises(ExperimentError) as caught:
        tb.Experiment.load(TABLE6, [f"motion.duration={'w' * length}"])
    assert str(caught.value).endswith(f"found '{'w' * 59}..." if cut else f"found '{'w' * 58}'")


def test_a_file_that_is_nested_too_deeply_is_named(tmp_path: Path) -> None:
    deep = tmp_path / "deep.toml"
    deep.write_text(f"a = {'[' * 100_000}")
    with pytest.raises(ExperimentError, match=r"deep\.toml: not a readable TOML file: nested too"):
        tb.Experiment.load(deep)


def test_an_experiment_does_not_change() -> None:
    """Neither its own keys nor those of its tables."""
    made = tb.Experiment.load(TABLE6)
    for table, name in ((made, "seed"), (made.motion, "duration"), (made.simulation, "step")):
        with pytest.raises((ValidationError, AttributeError)):
            setattr(table, name, 1)


def test_all_faults_are_listed_at_once() -> None:
    with pytest.raises(ExperimentError) as caught:
        tb.Experiment.load(TABLE6, ["motion.duration=-1", "speed=1", "seed=-4"])
    assert all(word in str(caught.value) for word in ("duration", "speed", "seed"))


@pytest.mark.parametrize(
    "table",
    ["measurement.torque_constant_error", "motion.max_velocity", "motion.max_acceleration"],
)
def test_a_table_for_a_joint_that_is_not_there_is_refused(table: str) -> None:
    experiment = tb.Experiment.load(TABLE6, [f"{table}.wrist=0.1"])
    said = f"{table} .*'wrist', the model has waist, shoulder, elbow"
    with pytest.raises(ExperimentError, match=said):
        tb.simulate(experiment)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["simulation.bandwidth=1e6"], "too fast for a controller"),
        (["motion.fundamental=1e9"], "too fast for measurement.rate"),
        (["motion.fundamental=1e-12"], "hardly move"),
        (["motion.duration=1e-3", "motion.fundamental=20.0"], "no two samples"),
        (["simulation.step=1e-9"], "more than 10000"),
        (["simulation.step=1e-320"], "makes inf steps a sample, more than 10000"),
    ],
)
def test_rates_that_do_not_fit_are_refused(settings: list[str], said: str) -> None:
    with pytest.raises(ExperimentError, match=said):
        tb.simulate(tb.Experiment.load(TABLE6, settings))


def test_a_step_that_does_not_divide_the_sample_is_refused() -> None:
    with pytest.raises(ExperimentError, match="does not divide"):
        tb.simulate(tb.Experiment.load(TABLE6, ["simulation.step=3e-4"]))


def test_the_resolved_file_says_the_same(quick: tb.Experiment, tmp_path: Path) -> None:
    path = tmp_path / "again.toml"
    path.write_text(quick.as_toml())
    assert tb.Experiment.load(path) == quick


def test_a_claim_holds_or_fails() -> None:
    assert Bound(at_most=1.0).holds(1.0)
    assert not Bound(at_most=1.0).holds(1.1)
    assert Bound(at_least=1.0).holds(2.0)
    assert not Bound(at_least=1.0, at_most=3.0).holds(float("nan"))


@pytest.mark.slow
def test_an_outcome_knows_every_metric_and_judges_the_claims(quick: tb.Experiment) -> None:
    outcome = tb.carry_out(quick)
    assert set(outcome.metrics) - {"external_floor"} == set(ALWAYS_JUDGED)
    assert set(outcome.verdicts) == set(quick.expect)
    strict = quick.model_copy(
        update={"expect": {"external_rms_relative_error": Bound(at_most=0.0)}}
    )
    assert not tb.carry_out(strict).as_expected


@pytest.mark.slow
def test_a_run_folder_repeats_the_run(quick: tb.Experiment, tmp_path: Path) -> None:
    write_run(tb.carry_out(quick), tmp_path / "run")
    assert sorted(p.name for p in (tmp_path / "run").iterdir()) == [
        "experiment.toml",
        "model",
        "recording.parquet",
        "result.json",
    ]
    first = (tmp_path / "run/result.json").read_bytes()
    write_run(tb.carry_out(tb.Experiment.load(tmp_path / "run/experiment.toml")), tmp_path / "run")
    assert (tmp_path / "run/result.json").read_bytes() == first
    content = json.loads(first)
    assert content["versions"]["mujoco"].startswith("4.")
    assert content["external"]["names"][0] == "mb3z"
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_different_experiments_go_to_different_folders(quick: tb.Experiment) -> None:
    other = quick.model_copy(update={"seed": 5})
    assert default_folder(quick) != default_folder(other)
    assert default_folder(quick) == default_folder(tb.Experiment.load(TABLE6, QUICK))


def test_a_key_of_very_many_parts_is_refused_before_it_is_parsed(tmp_path: Path) -> None:
    """The parser takes memory with the square of their number."""
    path = tmp_path / "e.toml"
    path.write_text(".".join("a" * 50_000) + " = 1\n")
    with pytest.raises(ExperimentError, match="a key has more than 1000 parts"):
        tb.Experiment.load(path)


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "e.toml"
    shutil.copy(TABLE6, path)
    size = path.stat().st_size
    with path.open("a") as file:
        file.write("#" * (LARGEST_FILE - size))
    assert tb.Experiment.load(path, [f"model='{ROOT / 'models/puma562.xml'}'"]).name == "table6"
    with path.open("a") as file:
        file.write("#")
    with pytest.raises(ExperimentError, match=r"it has more than 1e\+06 bytes"):
        tb.Experiment.load(path)


def test_a_number_of_very_many_digits_is_refused_in_plain_words(tmp_path: Path) -> None:
    path = tmp_path / "e.toml"
    path.write_text(f"seed = {'9' * 5000}\n")
    for file, words in ((path, []), (TABLE6, [f"seed={'9' * 5000}"])):
        with pytest.raises(ExperimentError, match="a number has thousands of digits") as found:
            tb.Experiment.load(file, words)
        assert "sys." not in str(found.value)


def test_a_key_with_dots_of_its_own_stands_in_quotes() -> None:
    content: dict[str, Any] = {}
    override(content, ['robot.lock."arm.elbow"=0.5', "robot.'a.b'.c='x'", "motion.duration=3"])
    wanted = {"lock": {"arm.elbow": 0.5}, "a.b": {"c": "x"}}
    assert content == {"robot": wanted, "motion": {"duration": 3}}


def test_tables_that_are_nested_too_deeply_are_refused() -> None:
    deep: list[Any] = []
    for _ in range(100_000):
        deep = [deep]
    with pytest.raises(ExperimentError, match="file: it is nested too deeply"):
        checked(RecordingTables, {"name": deep}, "file")
    while deep:  # taken apart by hand: Python's own way goes as deep
        deep = deep.pop()
