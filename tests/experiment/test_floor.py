"""The floor of a coarse step is what perfect instruments would give."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.lab.experiment.evaluate import evaluate
from testbed.lab.experiment.score import shared_errors
from tests.helpers.paths import ROOT
from tests.helpers.runs import MODELS


@pytest.mark.slow
def test_the_floor_of_a_coarse_step_is_the_error_of_perfect_instruments() -> None:
    """By an experiment of such instruments, which shares only the motion and the plant."""
    words = ["motion.duration=6.0", "motion.candidates=1", "excitation.clearance=off"]

    def load(name: str, *more: str) -> tb.Experiment:
        return tb.Experiment.load(ROOT / f"experiments/{name}.toml", [*words, *more])

    coarse = "simulation.step=1e-3"
    fine, noisy = load("table6"), load("table6", coarse)
    perfect = load("encoder_floor", coarse)
    assert "external_floor" not in evaluate(fine, tb.record(fine), methods=["external"]).metrics
    tree = tb.load_tree(MODELS["puma"])
    estimate = tb.identify(tree, tb.record(perfect), settings=perfect.identification)
    wanted = np.sqrt(np.mean(shared_errors(tree, estimate.base.values, zeros=True) ** 2))
    found = evaluate(noisy, tb.record(noisy), methods=["external"]).metrics
    assert found["external_floor"] == pytest.approx(wanted, rel=1e-6)
    assert found["external_floor"] < found["external_rms_relative_error"]
