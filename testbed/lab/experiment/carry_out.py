"""Carry out an experiment: record, identify, compare with the truth, validate, weigh."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from testbed.applications.payload.payload import payload
from testbed.applications.validate import validate
from testbed.bodies.posterior import reported_estimate
from testbed.core.base.diagnostics import diagnose
from testbed.core.base.errors import RecordingError, TestbedError
from testbed.core.base.stages import Progress, unreported
from testbed.core.estimation.identify import identify
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.views import on_its_base
from testbed.lab.experiment.evaluate import evaluate
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.motions import another_motion
from testbed.lab.experiment.record import record
from testbed.lab.experiment.results import write_recorded, write_run
from testbed.lab.experiment.rig import robot_of
from testbed.lab.experiment.run import Run, shown_motion
from testbed.lab.experiment.score import Score, accuracies
from testbed.lab.simulation.bodies import Payload
from testbed.lab.simulation.rollout import Watch

UNSEEN = 12.0
"""Seconds of it."""


def on_unseen_motion(run: Run, progress: Progress = unreported) -> Run:
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


def unseen(run: Run, progress: Progress = unreported) -> Recording | None:
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
    seed = experiment.seed
    other = experiment.with_(motion={"duration": duration}, seed=seed + 1)
    motion = another_motion(experiment, robot_of(experiment))
    return record(other, progress, installed=seed, motion=motion)


def validated(run: Run, recording: Recording) -> Run:
    """A run with its estimates validated.

    Args:
        run: The run.
        recording: Another one of the same robot and instrument.
    """
    recording = on_its_base(recording, run.tree)
    run = replace(run, unseen=recording)
    answers = {
        method: reported_estimate(estimate, run.posterior.get(method))
        for method, estimate in run.estimates.items()
    }
    try:
        found = {
            method: validate(
                run.tree,
                recording,
                answer.estimate,
                settings=run.settings,
                models=answer.models,
                held=answer.held,
            )
            for method, answer in answers.items()
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


def with_payload_metrics(run: Run, progress: Progress = unreported) -> Run:
    """A run with the figures of its payload, if a claim is about them.

    The robot without the payload makes another recording, with other noise.

    Args:
        run: The run.
        progress: Called with samples done and samples in all.
    """
    experiment = run.experiment
    if experiment is None or run.score is None or "external" not in run.estimates:
        return run
    loads = [each for each in experiment.simulation.effect if isinstance(each, Payload)]
    if len(loads) != 1 or not any(
        name.startswith("payload_") for name in experiment.expect
    ):
        return run
    empty = _without(experiment)
    tree, settings = robot_of(empty), replace(experiment.identification, zeros=False)
    without = identify(tree, record(empty, progress).blind(), settings=settings)
    loaded = identify(tree, run.recording.blind(), settings=settings)
    found = payload(tree, without, loaded, loads[0].joint or None)
    metrics = {}
    if found.identifiable[0]:
        error, sigma = (
            abs(float(found.values[0]) - loads[0].mass),
            float(found.sigma[0]),
        )
        metrics = {
            "payload_mass_error": error,
            "payload_mass_sigma": sigma,
            "payload_mass_z": error / sigma,
        }
    if found.centre is not None and np.isfinite(found.centre[0]).all():
        metrics["payload_centre_error"] = float(
            np.linalg.norm(found.centre[0] - loads[0].centre)
        )
    return run.with_metrics(metrics).with_diagnostics(found.diagnostics)


def _without(experiment: Experiment) -> Experiment:
    """The same without payloads, with another motion and other noise."""
    effects = experiment.simulation.effect
    others = tuple(each for each in effects if not isinstance(each, Payload))
    return experiment.with_(simulation={"effect": others}, seed=experiment.seed + 2)


Stage = Callable[[str], AbstractContextManager[Progress]]
"""Makes what shows how far a stage of this name is."""


def carry_out(
    experiment: Experiment,
    progress: Progress = unreported,
    watch: Watch = unreported,
    *,
    folder: Path | None = None,
    stage: Stage | None = None,
) -> Run:
    """Simulate, identify by both methods, compare with the truth, validate on another motion.

    Args:
        experiment: What to do.
        progress: Called with samples done and samples in all.
        watch: Called with what happens while it is simulated, a second or so at a time.
        folder: Run folder to write at the end; an older one stays until the new one is there.
        stage: Makes what is called in place of `progress`, stage by stage.

    Raises:
        TestbedError: It cannot be carried out. Where nothing stands in the folder, it then has
            the recording.
    """
    begun = stage or (lambda name: nullcontext(progress))
    with begun("simulating") as bar:
        recording = record(experiment, bar, watch)
    try:
        with begun("identifying") as bar:
            run = evaluate(experiment, recording, bar)
    except TestbedError as error:
        if folder is None or folder.exists():
            raise
        write_recorded(experiment, recording, folder)
        raise RecordingError(f"{error}; the recording is kept in '{folder}'") from None
    with begun("validating on an unseen motion") as bar:
        run = on_unseen_motion(with_payload_metrics(run, bar), bar)
    if folder is not None:
        write_run(run, folder)
    return run
