"""A motion that no estimate has seen, to check a run's predictions on."""

from __future__ import annotations

from testbed.experiment.carry_out import simulate
from testbed.experiment.run import Run
from testbed.identification.passes import Progress
from testbed.recordings.recording import Recording

UNSEEN = 12.0
"""Seconds of it."""


def unseen(run: Run, progress: Progress = lambda done, total: None) -> Recording | None:
    """The same robot and instrument along another motion, with other noise.

    Args:
        run: The run.
        progress: Called with samples done and samples in all.

    Returns:
        The recording; None if no experiment made the run, so that there is nothing to repeat.

    Raises:
        TestbedError: The other motion cannot be simulated.
    """
    experiment = run.experiment
    if experiment is None:
        return None
    asked = experiment.motion
    duration = min(max(UNSEEN, 1.0 / asked.fundamental), asked.duration)
    motion = asked.model_copy(update={"duration": duration, "candidates": 1})
    other = experiment.model_copy(update={"motion": motion, "seed": experiment.seed + 1})
    return simulate(other, progress)
