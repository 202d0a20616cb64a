"""A payload that an experiment puts into the plant, weighed by the difference of two recordings."""

from __future__ import annotations

from dataclasses import replace

import pytest

import testbed as tb
from testbed.experiment.evaluate import evaluate
from testbed.experiment.experiment_tables import Bound
from testbed.experiment.payload_score import with_payload_metrics
from testbed.experiment.run import Run
from tests.helpers.paths import ROOT

SHORT = ["motion.duration=10", "motion.candidates=1", "simulation.step=5e-4"]


@pytest.fixture(scope="module")
def run() -> Run:
    experiment = tb.Experiment.load(ROOT / "experiments/payload.toml", SHORT)
    return with_payload_metrics(evaluate(experiment, tb.simulate(experiment)))


@pytest.mark.slow
def test_the_load_is_found_within_its_sigma(run: Run) -> None:
    metrics = run.metrics
    assert 0 < metrics["payload_mass_sigma"] < 5e-3
    assert metrics["payload_mass_error"] < 4 * metrics["payload_mass_sigma"]
    assert metrics["payload_mass_z"] == pytest.approx(
        metrics["payload_mass_error"] / metrics["payload_mass_sigma"]
    )
    assert metrics["payload_centre_error"] < 1e-2
    assert {name for name in run.verdicts if name.startswith("payload_")} == set(run.verdicts)


@pytest.mark.slow
def test_without_a_claim_or_with_two_loads_nothing_more_is_simulated(run: Run) -> None:
    assert run.experiment is not None
    (load,) = run.experiment.simulation.effect
    for change in (
        {"expect": {"external_max_z": Bound(at_most=4.0)}},
        {"simulation": run.experiment.simulation.model_copy(update={"effect": (load, load)})},
        {"simulation": run.experiment.simulation.model_copy(update={"effect": ()})},
    ):
        other = replace(run, experiment=run.experiment.model_copy(update=change))
        assert with_payload_metrics(other) is other
