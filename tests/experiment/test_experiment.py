"""Experiment files and comparisons of variants: every key is checked and named, claims are kept."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args, get_origin

import numpy as np
import pytest
from pydantic import BaseModel, ValidationError

import testbed as tb
from testbed.errors import ExperimentError, TestbedError
from testbed.experiment.comparison import PLAIN, Comparison, compare, comparison_as_json
from testbed.experiment.evaluate import evaluate, robot_of
from testbed.experiment.experiment import ExperimentTables, RecordingTables
from testbed.experiment.experiment_tables import Bound, JointTable
from testbed.experiment.run_folder import default_folder
from testbed.experiment.score import shared_errors
from testbed.toml_text import LARGEST_FILE, checked, override
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses

TABLE6 = ROOT / "experiments/table6.toml"


def test_what_ships_is_readable_and_makes_a_claim() -> None:
    for path in sorted((ROOT / "experiments").glob("*.toml")):
        if "variant" in tomllib.loads(path.read_text()):
            assert all(each.says is not None for each in Comparison.load(path).variants[1:])
        else:
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
    for table, name in ((again, "seed"), (again.motion, "duration"), (again.simulation, "step")):
        with pytest.raises((ValidationError, AttributeError)):
            setattr(table, name, 1)
    content: dict[str, Any] = {}
    override(content, ['robot.lock."arm.elbow"=0.5', "robot.'a.b'.c='x'", "motion.duration=3"])
    quoted = {"lock": {"arm.elbow": 0.5}, "a.b": {"c": "x"}}
    assert content == {"robot": quoted, "motion": {"duration": 3}}


def numbers_of(table: type[BaseModel], path: str = "") -> Iterator[str]:
    """Paths of all keys of numbers with a fraction in a table and those within it."""

    def is_number(kind: Any) -> bool:
        lists = (dict, list, tuple)
        return kind is float or (
            get_origin(kind) not in lists and any(map(is_number, get_args(kind)))
        )

    for name, field in table.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from numbers_of(kind, f"{path}{name}.")
        elif is_number(kind):
            yield f"{path}{name}"


def test_what_is_not_understood_or_does_not_fit_robot_and_clock_is_named() -> None:
    """All faults at once; no number is infinite."""
    paths = [*numbers_of(ExperimentTables), *numbers_of(JointTable, "robot.joint.waist.")]
    assert len(paths) > 10
    infinite = ((f"{path}={('inf', '-inf', 'nan')[k % 3]}", path) for k, path in enumerate(paths))
    for setting, *culprits in (
        *infinite,
        ("motion.duraton=7", "[motion]", "'duraton'", "'duration'"),
        ("duration=3", "'duration'", "motion.duration"),
        ("expect={internal_rms_relative_error={}}", "at_most"),
        (f"motion.duration={'w' * 500}", "motion.duration", "w" * 50),
        ("motion.harmonics=2.5", "motion.harmonics"),
        ("name=../up", "name"),
        ("motion.duration", "motion.duration"),
        ("name.first=1", "'name'"),
        ('motion.file="a\\u0000b"', "motion.file"),
    ):
        with refuses(ExperimentError, *culprits):
            tb.Experiment.load(TABLE6, [setting])
    with pytest.raises(ExperimentError) as caught:
        tb.Experiment.load(TABLE6, ["motion.duration=-1", "speed=1", "seed=-4"])
    assert all(word in str(caught.value) for word in ("duration", "speed", "seed"))
    for word, culprit in (
        ("measurement.torque_constant_error.wrist=0.1", "'wrist'"),
        ("motion.max_velocity.wrist=0.1", "'wrist'"),
        ('robot.base="measured"', "robot.base"),
        ("simulation.bandwidth=1e6", "bandwidth"),
        ("motion.fundamental=1e-12", "fundamental"),
        ("simulation.step=1e-320", "step"),
        ("simulation.step=3e-4", "step"),
    ):
        with refuses(ExperimentError, culprit):
            tb.simulate(tb.Experiment.load(TABLE6, [word]))


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
    deep: list[Any] = []
    for _ in range(100_000):
        deep = [deep]
    with refuses(ExperimentError, "file"):
        checked(RecordingTables, {"name": deep}, "file")
    while deep:  # taken apart by hand: Python's own way goes as deep
        deep = deep.pop()


def test_a_claim_holds_or_fails() -> None:
    for bound, value, holds in (
        (Bound(at_most=1.0), 1.0, True),
        (Bound(at_most=1.0), 1.1, False),
        (Bound(at_least=1.0), 2.0, True),
        (Bound(at_least=1.0), 0.9, False),
        (Bound(at_least=1.0, at_most=3.0), float("nan"), False),
    ):
        assert bound.holds(value) is holds


# variants share one motion and are what each would be alone


VARIANTS = """
[[variant]]
name = "late"
set = ['measurement.fault=[{kind="plate_delay",delay=4e-3}]']
remedy = ['identification.nuisances=["skew"]']
says = "a plate that is late"
remedied.external_max_z = { at_most = 6.0 }
[[variant]]
name = "quiet"
set = ["measurement.force_noise=0.4"]
says = ""
"""


def comparison(folder: Path, variants: str) -> Comparison:
    head = f'name = "made"\nexperiment = "{TABLE6}"\nmethods = ["external"]\n'
    (folder / "made.toml").write_text(head + variants)
    short = ["motion.duration=10", "motion.candidates=1", "simulation.step=1e-3", "seed=3"]
    return Comparison.load(folder / "made.toml", short)


@pytest.mark.slow
def test_a_fault_is_said_and_its_remedy_takes_its_error_away(tmp_path: Path) -> None:
    """Of variants that are simulated once; a wrong claim or name is not as expected."""
    asked = comparison(tmp_path, VARIANTS)
    rows = list(compare(asked))
    plain, late, quiet = rows
    assert [row.variant.name for row in rows] == [PLAIN, "late", "quiet"]
    assert len({id(row.run.recording.truth) for row in rows}) == 1
    assert {tuple(row.run.estimates) for row in rows} == {("external",)}
    alone = tb.simulate(late.variant.experiment).measured("wrench")
    np.testing.assert_array_equal(late.run.recording.measured("wrench"), alone)
    assert (plain.named, late.named, quiet.named) == (None, True, True)
    assert all(row.as_expected for row in rows)
    assert late.remedied is not None
    error = "external_rms_relative_error"
    assert late.remedied.metrics[error] < 0.5 * late.run.metrics[error]
    for says in ("", "crosstalk"):
        wrong = replace(late, variant=replace(late.variant, says=says))
        assert (wrong.named, wrong.as_expected) == (False, False)
    assert late.run.experiment is not None
    bound = {"external_max_z": Bound(at_most=0.0)}
    claim = late.run.experiment.model_copy(update={"expect": bound})
    assert not replace(late, run=replace(late.run, experiment=claim)).as_expected
    (skew,) = comparison_as_json(asked, rows)["variants"][1]["remedied"]["nuisances"]["external"]
    assert skew["value"] == pytest.approx(4e-3, abs=10 * skew["sigma"])


def test_what_a_comparison_cannot_mean_is_named(tmp_path: Path) -> None:
    for variants, culprit in {
        '[[variant]]\nname = "x"\nset = ["motion.duration=3"]': "motion",
        '[[variant]]\nname = "x"\nset = ["seed=4"]': "seed",
        '[[variant]]\nname = "x"\nremedied.external_max_z = { at_most = 1.0 }': "remedy",
        '[[variant]]\nset = ["seed=4"]': "name",
        "": "variant",
    }.items():
        with refuses(TestbedError, culprit):
            comparison(tmp_path, variants)


@pytest.mark.slow
def test_the_floor_of_a_coarse_step_is_the_error_of_perfect_instruments() -> None:
    """By an experiment of such instruments, which shares only the motion and the plant."""
    words = ["motion.duration=6.0", "motion.candidates=1", "excitation.clearance=off"]
    words.append("simulation.step=1e-3")
    noisy = tb.Experiment.load(TABLE6, words)
    floor = ROOT / "experiments/encoder_floor.toml"
    perfect = tb.Experiment.load(floor, [*words, "identification.noise=white"])
    tree = robot_of(perfect)
    estimate = tb.identify(tree, tb.simulate(perfect), settings=perfect.identification)
    wanted = np.sqrt(np.mean(shared_errors(tree, estimate.base.values, zeros=True) ** 2))
    found = evaluate(noisy, tb.simulate(noisy), methods=["external"]).metrics
    assert found["external_floor"] == pytest.approx(wanted, rel=1e-6)
    assert found["external_floor"] < found["external_rms_relative_error"]
