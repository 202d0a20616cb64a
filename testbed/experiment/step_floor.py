"""What a coarse step of the simulation costs: the error that perfect instruments would leave.

Dry friction reverses within a step, and positions are those of a step's ends. In statistics a
coarse step pays; what it costs is found run by run, by the same motion measured without a fault.
"""

from __future__ import annotations

from dataclasses import replace

from testbed.errors import TestbedError
from testbed.experiment.experiment_tables import SimulationTable
from testbed.experiment.run import Run
from testbed.experiment.score import root_mean_square, shared_errors
from testbed.identification.identify import identify
from testbed.instruments.chain import Instrument, measured_again

FINE = SimulationTable().step
"""Step up to which the floor is not looked for [s]: it is below what instruments leave."""


def with_floor(run: Run) -> Run:
    """A run with the metric `external_floor`, where its step is coarse.

    Args:
        run: Of an experiment.
    """
    experiment = run.experiment
    if experiment is None or run.score is None or "external" not in run.estimates:
        return run
    if experiment.simulation.step <= FINE * (1 + 1e-9):
        return run
    asked = experiment.measurement
    perfect = Instrument(rate=asked.rate, averaged=asked.averaged)
    seen = replace(measured_again(run.recording, perfect, experiment.seed).blind(), tare=None)
    plain = replace(run.settings, noise="white", nuisances=(), known={}, weights="channels")
    try:
        estimate = identify(run.tree, seen, "external", settings=plain, threads=1)
    except TestbedError:
        return run
    floor = root_mean_square(shared_errors(run.tree, estimate.base.values, plain.zeros))
    if floor is None:
        return run
    metrics = {**run.score.metrics, "external_floor": floor}
    return replace(run, score=replace(run.score, metrics=metrics))
