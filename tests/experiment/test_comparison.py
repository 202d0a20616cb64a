"""Variants of an experiment share one motion and are what each would be alone, to the bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import TestbedError
from testbed.experiment.comparison import PLAIN, Comparison, compare
from testbed.experiment.evaluate import evaluate
from testbed.experiment.experiment_tables import Bound
from testbed.experiment.score import shared_errors
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.runs import MODELS

SHORT = ["motion.duration=10", "motion.candidates=1", "simulation.step=1e-3", "seed=3"]

LATE = """
[[variant]]
name = "late"
set = ['measurement.fault=[{kind="plate_delay",delay=4e-3}]']
remedy = ['identification.nuisances=["skew"]']
says = "sensor.skew"
remedied.external_max_z = { at_most = 6.0 }
"""

QUIET = """
[[variant]]
name = "quiet"
set = ["measurement.force_noise=0.4"]
says = ""
"""


def written(folder: Path, variants: str) -> Path:
    """A comparison's file."""
    path = folder / "made.toml"
    experiment = ROOT / "experiments/table6.toml"
    path.write_text(
        f'name = "made"\nmethods = ["external"]\nexperiment = "{experiment}"\n{variants}'
    )
    return path


@pytest.mark.slow
def test_a_fault_is_said_and_its_remedy_takes_its_error_away(tmp_path: Path) -> None:
    """Of variants that are simulated once; a wrong claim or name is not as expected."""
    comparison = Comparison.load(written(tmp_path, LATE + QUIET), SHORT)
    rows = list(compare(comparison))
    plain, late, quiet = rows
    assert [row.variant.name for row in rows] == [PLAIN, "late", "quiet"]
    for row in (late, quiet):
        alone = tb.simulate(row.variant.experiment)
        np.testing.assert_array_equal(alone.measured("wrench"), row.run.recording.wrench)
        np.testing.assert_array_equal(alone.position, row.run.recording.position)
    assert (plain.named, late.named, quiet.named) == (None, True, True)
    assert all(row.as_expected for row in rows)
    assert late.remedied is not None
    error = "external_rms_relative_error"
    assert late.remedied.metrics[error] < 0.5 * late.run.metrics[error]
    for says in ("", "sensor.crosstalk"):
        wrong = replace(late, variant=replace(late.variant, says=says))
        assert (wrong.named, wrong.as_expected) == (False, False)
    claimed = late.variant.experiment.model_copy(update={"expect": {"none": Bound(at_most=1.0)}})
    assert not replace(late, run=replace(late.run, experiment=claimed)).as_expected


def test_what_a_comparison_cannot_mean_is_named(tmp_path: Path) -> None:
    for variants, culprit in {
        '[[variant]]\nname = "x"\nset = ["motion.duration=3"]': "motion",
        '[[variant]]\nname = "x"\nset = ["seed=4"]': "seed",
        '[[variant]]\nname = "x"\nremedied.external_max_z = { at_most = 1.0 }': "remedy",
        '[[variant]]\nset = ["seed=4"]': "name",
        "": "variant",
    }.items():
        with refuses(TestbedError, culprit):
            Comparison.load(written(tmp_path, variants), SHORT)
    ours = Comparison.load(ROOT / "experiments/faults.toml")
    assert all(variant.says is not None for variant in ours.variants[1:])


@pytest.mark.slow
def test_the_floor_of_a_coarse_step_is_the_error_of_perfect_instruments() -> None:
    """By an experiment of such instruments, which shares only the motion and the plant."""
    words = ["motion.duration=6.0", "motion.candidates=1", "excitation.clearance=off"]

    def load(name: str, *more: str) -> tb.Experiment:
        return tb.Experiment.load(ROOT / f"experiments/{name}.toml", [*words, *more])

    coarse, white = "simulation.step=1e-3", "identification.noise=white"
    fine, noisy = load("table6"), load("table6", coarse)
    perfect = load("encoder_floor", coarse, white)
    assert "external_floor" not in evaluate(fine, tb.simulate(fine), methods=["external"]).metrics
    tree = tb.load_tree(MODELS["puma"])
    estimate = tb.identify(tree, tb.simulate(perfect), settings=perfect.identification)
    wanted = np.sqrt(np.mean(shared_errors(tree, estimate.base.values, zeros=True) ** 2))
    found = evaluate(noisy, tb.simulate(noisy), methods=["external"]).metrics
    assert found["external_floor"] == pytest.approx(wanted, rel=1e-6)
    assert found["external_floor"] < found["external_rms_relative_error"]
