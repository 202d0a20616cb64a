"""Carry out an experiment: simulate, identify, compare with the truth, validate."""

from __future__ import annotations

from testbed.experiment.evaluate import evaluate
from testbed.experiment.experiment import Experiment
from testbed.experiment.payload_score import with_payload_metrics
from testbed.experiment.run import Run
from testbed.experiment.simulate import simulate
from testbed.experiment.unseen import on_unseen_motion
from testbed.identification.passes import Progress
from testbed.simulation.rollout import Watch


def carry_out(
    experiment: Experiment,
    progress: Progress = lambda done, total: None,
    watch: Watch = lambda time, truth: None,
) -> Run:
    """Simulate, identify by both methods, compare with the truth, validate on another motion.

    Args:
        experiment: What to do.
        progress: Called with samples done and samples in all.
        watch: Called with what happens while it is simulated, a second or so at a time.
    """
    run = evaluate(experiment, simulate(experiment, progress, watch))
    return checked_elsewhere(run, progress)


def checked_elsewhere(run: Run, progress: Progress = lambda done, total: None) -> Run:
    """A run with all that other simulations say of it: its payload, a motion it has not seen.

    Args:
        run: The run.
        progress: Called with samples done and samples in all.
    """
    return on_unseen_motion(with_payload_metrics(run, progress), progress)
