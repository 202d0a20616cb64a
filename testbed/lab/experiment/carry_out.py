"""Carry out an experiment: simulate, identify, compare with the truth, validate."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from testbed.applications.payload.payload import payload
from testbed.applications.validate import validate
from testbed.bodies.posterior import reported_estimate
from testbed.core.base.diagnostics import make_diagnostic
from testbed.core.base.errors import RecordingError, TestbedError
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.estimation.identify import identify
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.views import adapt_to_robot
from testbed.lab.experiment.evaluate import evaluate
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.motions import validation_motion
from testbed.lab.experiment.record import record
from testbed.lab.experiment.results import write_recording_folder, write_run
from testbed.lab.experiment.rig import robot_of
from testbed.lab.experiment.run import Run, recorded_motion
from testbed.lab.experiment.score import Score, prediction_accuracies
from testbed.lab.simulation.bodies import Payload
from testbed.lab.simulation.rollout import BlockCallback

VALIDATION_DURATION = 12.0
"""Duration of a validation recording, or one period if longer, at most the experiment's [s]."""


def with_simulated_validation(run: Run, progress: Progress = ignore_progress) -> Run:
    """Validate a run's estimates on a newly simulated recording of another motion.

    Args:
        run: Run of an experiment.
        progress: Called with the number of finished samples and of all samples.

    Returns:
        Run with the validation. The run is unchanged if it has no estimates or no experiment, and
        has a warning if the other motion cannot be simulated.
    """
    if not run.estimates:
        return run
    try:
        recording = simulate_validation_recording(run, progress)
    except TestbedError as error:
        return run.with_diagnostics(
            [make_diagnostic("estimate.not-validated", reason=error)]
        )
    return run if recording is None else with_validation(run, recording)


def simulate_validation_recording(
    run: Run, progress: Progress = ignore_progress
) -> Recording | None:
    """Simulate the same robot and sensors along another, equally fast motion.

    The sensor noise differs from that of the run.

    Args:
        run: Run of an experiment.
        progress: Called with the number of finished samples and of all samples.

    Returns:
        Recording of at most `VALIDATION_DURATION` or one period, whichever is longer; None if the
            run has no experiment.

    Raises:
        TestbedError: The other motion cannot be simulated.
    """
    experiment = run.experiment
    if experiment is None:
        return None
    table = experiment.motion
    duration = min(max(VALIDATION_DURATION, 1.0 / table.fundamental), table.duration)
    seed = experiment.seed
    validation_experiment = experiment.with_(
        motion={"duration": duration}, seed=seed + 1
    )
    motion = validation_motion(experiment, robot_of(experiment))
    return record(validation_experiment, progress, installed=seed, motion=motion)


def with_validation(run: Run, recording: Recording) -> Run:
    """Validate a run's estimates on another recording.

    If the run has a posterior for a method, the reported one of the two estimates is validated.

    Args:
        run: Run with estimates.
        recording: Another recording of the same robot and sensors.

    Returns:
        Run with the validation, its diagnostics, and the accuracy of predictions along this
        recording; with a warning instead if the recording cannot be used.
    """
    recording = adapt_to_robot(recording, run.tree)
    run = replace(run, unseen=recording)
    reported = {
        method: reported_estimate(estimate, run.posterior.get(method))
        for method, estimate in run.estimates.items()
    }
    try:
        validations = {
            method: validate(
                run.tree,
                recording,
                report.estimate,
                settings=run.settings,
                models=report.models,
                held=report.held,
            )
            for method, report in reported.items()
        }
    except TestbedError as error:
        return run.with_diagnostics(
            [make_diagnostic("estimate.not-validated", reason=error)]
        )
    run = run.with_diagnostics(
        each for v in validations.values() for each in v.diagnostics
    )
    return replace(run, validation=validations, score=_validation_score(run, recording))


def _validation_score(run: Run, recording: Recording) -> Score | None:
    """Score of a run with the accuracy of its predictions along a recording's motion.

    The result is None if the run has no score because the truth is unknown.
    """
    if run.score is None:
        return None
    motion, _ = recorded_motion(recording, run.settings)
    accuracy = prediction_accuracies(
        run.tree, run.estimates, run.settings.zeros, motion
    )
    return replace(run.score, accuracy=accuracy)


def with_payload_metrics(run: Run, progress: Progress = ignore_progress) -> Run:
    """Add the errors of the identified payload to a run's metrics.

    The metrics are "payload_mass_error", "payload_mass_sigma", "payload_mass_z" and
    "payload_centre_error", where identifiable. The payload is identified from the difference
    between the run's estimate and an estimate from a second simulated recording, without payload
    and with other noise. The run is unchanged if its claims name no payload metric, if the robot
    does not carry exactly one payload, or if there is no estimate from the force plate.

    Args:
        run: Run of an experiment.
        progress: Called with the number of finished samples and of all samples.
    """
    experiment = run.experiment
    if experiment is None or run.score is None or "wrench" not in run.estimates:
        return run
    payloads = [
        each for each in experiment.simulation.effect if isinstance(each, Payload)
    ]
    if len(payloads) != 1 or not any(
        name.startswith("payload_") for name in experiment.expect
    ):
        return run
    unloaded_experiment = _experiment_without_payload(experiment)
    tree, settings = (
        robot_of(unloaded_experiment),
        replace(experiment.identification, zeros=False),
    )
    unloaded_estimate = identify(
        tree, record(unloaded_experiment, progress).blind(), settings=settings
    )
    loaded_estimate = identify(tree, run.recording.blind(), settings=settings)
    estimate = payload(
        tree, unloaded_estimate, loaded_estimate, payloads[0].joint or None
    )
    metrics = {}
    if estimate.identifiable[0]:
        error, sigma = (
            abs(float(estimate.values[0]) - payloads[0].mass),
            float(estimate.sigma[0]),
        )
        metrics = {
            "payload_mass_error": error,
            "payload_mass_sigma": sigma,
            "payload_mass_z": error / sigma,
        }
    if estimate.centre is not None and np.isfinite(estimate.centre[0]).all():
        metrics["payload_centre_error"] = float(
            np.linalg.norm(estimate.centre[0] - payloads[0].centre)
        )
    return run.with_metrics(metrics).with_diagnostics(estimate.diagnostics)


def _experiment_without_payload(experiment: Experiment) -> Experiment:
    """Experiment without payloads and with another seed for motion and noise."""
    effects = experiment.simulation.effect
    other_effects = tuple(each for each in effects if not isinstance(each, Payload))
    return experiment.with_(
        simulation={"effect": other_effects}, seed=experiment.seed + 2
    )


StageProgress = Callable[[str], AbstractContextManager[Progress]]
"""Function that opens a progress display for the stage of the given name."""


def carry_out(
    experiment: Experiment,
    progress: Progress = ignore_progress,
    watch: BlockCallback = ignore_progress,
    *,
    folder: Path | None = None,
    stage: StageProgress | None = None,
) -> Run:
    """Simulate a recording, identify by both methods, score against the truth, and validate.

    The validation uses a second simulated motion.

    Args:
        experiment: Robot, motion, sensors and claims.
        progress: Called with the number of finished samples and of all samples.
        watch: Called with the simulated states about once a second of simulation.
        folder: Run folder to write at the end; an older folder is kept until the new one is
            complete.
        stage: Function that opens a progress display for each stage; it replaces `progress`.

    Raises:
        TestbedError: The experiment cannot be carried out. If the recording exists and the folder
            does not, the recording is written to the folder first.
    """
    begin_stage = stage or (lambda name: nullcontext(progress))
    with begin_stage("simulating") as bar:
        recording = record(experiment, bar, watch)
    try:
        with begin_stage("identifying") as bar:
            run = evaluate(experiment, recording, bar)
    except TestbedError as error:
        if folder is None or folder.exists():
            raise
        write_recording_folder(experiment, recording, folder)
        raise RecordingError(f"{error}; the recording is kept in '{folder}'") from None
    with begin_stage("validating on an unseen motion") as bar:
        run = with_simulated_validation(with_payload_metrics(run, bar), bar)
    if folder is not None:
        write_run(run, folder)
    return run
