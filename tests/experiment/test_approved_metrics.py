"""Every metric of a run, on short forms of the shipped experiments, as approved."""

from __future__ import annotations

from functools import cache

import pytest

import testbed as tb
from testbed.experiment.carry_out import carry_out
from testbed.experiment.experiment_tables import METRICS
from testbed.experiment.run import Run
from tests.helpers.approved import hold
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.slow

SHORT = ("motion.duration=10", "simulation.step=5e-4", "motion.candidates=2")
SHIPPED = ("torque_constants", "consistent", "payload", "rotors", "blind_calibration", "tilt")


@cache
def run_of(name: str) -> Run:
    return carry_out(tb.Experiment.load(ROOT / f"experiments/{name}.toml", SHORT))


@pytest.mark.parametrize("name", SHIPPED)
def test_metrics_and_words_of_a_run_are_as_approved(name: str) -> None:
    run = run_of(name)
    lines = [f"{metric}: {value:.5g}" for metric, value in sorted(run.metrics.items())]
    lines += [f"warning: {line}" for line in run.warnings]
    hold(f"metrics_{name}.txt", "\n".join(lines) + "\n")


def test_every_metric_occurs() -> None:
    assert set(METRICS) <= {metric for name in SHIPPED for metric in run_of(name).metrics}
