"""A motion that no estimate has seen: a run's estimates are validated on it."""

from __future__ import annotations

from dataclasses import replace

from testbed.diagnostics.diagnostic import diagnose
from testbed.errors import TestbedError
from testbed.experiment.accuracy import accuracies
from testbed.experiment.evaluate import robot_of
from testbed.experiment.motions import another_motion
from testbed.experiment.run import Run
from testbed.experiment.score import Score
from testbed.experiment.shown_motion import shown_motion
from testbed.experiment.simulate import simulate
from testbed.identification.regression.passes import Progress
from testbed.identification.validate import validate
from testbed.recordings.recording import Recording

UNSEEN = 12.0
"""Seconds of it."""


def on_unseen_motion(run: Run, progress: Progress = lambda done, total: None) -> Run:
    """A run with its estimates validated on another motion.

    Args:
        run: The run.
        progress: Called with samples done and samples in all.

    Returns:
        The run as it is, with a warning, where the other motion cannot be simulated; without one
        where no experiment made the run, or it has no estimate.
    """
    if not run.estimates:
        return run
    try:
        recording = unseen(run, progress)
    except TestbedError as error:
        return run.with_diagnostics([diagnose("estimate.not-validated", reason=error)])
    return run if recording is None else validated(run, recording)


def unseen(run: Run, progress: Progress = lambda done, total: None) -> Recording | None:
    """The same robot and instrument along another motion as fast, with other noise.

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
    shorter = asked.model_copy(update={"duration": duration})
    other = experiment.model_copy(update={"motion": shorter, "seed": experiment.seed + 1})
    motion = another_motion(experiment, robot_of(experiment))
    return simulate(other, progress, installed=experiment.seed, motion=motion)


def validated(run: Run, recording: Recording) -> Run:
    """A run with its estimates validated.

    Args:
        run: The run.
        recording: Another one of the same robot and instrument.
    """
    run = replace(run, unseen=recording)
    try:
        found = {
            method: validate(run.tree, recording, estimate, settings=run.settings)
            for method, estimate in run.estimates.items()
        }
    except TestbedError as error:
        return run.with_diagnostics([diagnose("estimate.not-validated", reason=error)])
    run = run.with_diagnostics(each for v in found.values() for each in v.diagnostics)
    return replace(run, validation=found, score=_judged(run, recording))


def _judged(run: Run, recording: Recording) -> Score | None:
    """The run's score, its predictions being of this motion."""
    if run.score is None:
        return None
    motion, _ = shown_motion(recording, run.settings)
    accuracy = accuracies(run.tree, run.estimates, run.settings.zeros, motion)
    return replace(run.score, accuracy=accuracy)
