"""The floor of a coarse step: what perfect instruments leave, stated by the run itself."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.experiment.evaluate import evaluate
from testbed.experiment.score import shared_errors
from tests.helpers.paths import ROOT

WORDS = ("motion.duration=6.0", "motion.candidates=2", "excitation.clearance=off")


def run(file: str, *words: str) -> dict[str, float]:
    experiment = tb.Experiment.load(ROOT / f"experiments/{file}.toml", [*WORDS, *words])
    metrics = evaluate(experiment, tb.simulate(experiment), methods=["external"]).metrics
    return dict(metrics)


@pytest.mark.slow
def test_only_a_coarse_step_has_a_floor_to_state() -> None:
    assert "external_floor" not in run("table6")
    assert 0 < run("table6", "simulation.step=1e-3")["external_floor"] < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_it_is_the_error_of_an_experiment_whose_instruments_are_perfect(seed: int) -> None:
    """By that experiment itself, which shares only the motion and the plant."""
    words = (f"seed={seed}", "simulation.step=1e-3")
    noisy = run("table6", *words)
    white = "identification.noise=white"
    perfect = tb.Experiment.load(
        ROOT / "experiments/encoder_floor.toml",
        # the plate's noise has a say in which motion is chosen
        [*WORDS, *words, white, "motion.candidates=1"],
    )
    asked = tb.Experiment.load(
        ROOT / "experiments/table6.toml", [*WORDS, *words, "motion.candidates=1"]
    )
    tree = tb.load_tree(ROOT / "models/puma562.xml")
    estimate = tb.identify(tree, tb.simulate(perfect), settings=perfect.identification)
    errors = shared_errors(tree, estimate.base.values, zeros=True)
    wanted = np.sqrt(np.mean(errors**2))
    found = evaluate(asked, tb.simulate(asked), methods=["external"]).metrics["external_floor"]
    assert found == pytest.approx(wanted, rel=1e-6)
    assert found < noisy["external_rms_relative_error"]
