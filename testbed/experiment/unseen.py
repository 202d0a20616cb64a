"""A run as a report tells it: what was asked, what came out, and a motion nobody has seen."""

from __future__ import annotations

from pathlib import Path

from testbed.errors import TestbedError
from testbed.experiment.carry_out import simulate
from testbed.experiment.experiment import Experiment
from testbed.experiment.results import result
from testbed.experiment.run import Run
from testbed.identification.passes import Progress
from testbed.recordings.recording import Recording
from testbed.report.contents import Subject

UNSEEN = 12.0
"""Seconds of the motion on which predictions are checked."""


def subject_of(run: Run, progress: Progress = lambda done, total: None) -> Subject:
    """What there is to report of a run; simulates another motion to check predictions on.

    Args:
        run: Of an experiment.
        progress: Called with samples done and samples in all.
    """
    experiment, metrics = run.experiment, run.metrics
    assert experiment is not None
    other, warnings = None, []
    try:
        other = unseen(experiment, progress)
    except TestbedError as error:
        warnings.append(f"predictions are checked on the identified motion only: {error}")
    verdicts = [
        {
            "name": name.replace("_", " "),
            "wanted": bound.wanted,
            "value": f"{metrics[name]:.3g}",
            "holds": run.verdicts[name],
        }
        for name, bound in experiment.expect.items()
    ]
    return Subject(
        title=run.name,
        tree=run.tree,
        recording=run.recording,
        unseen=other,
        external=run.estimates["external"],
        internal=run.estimates["internal"],
        truths=run.truths,
        claim=experiment.claim,
        verdicts=verdicts,
        asked=_asked(run),
        settings=run.settings,
        origin=_origin(run),
        warnings=(*run.warnings, *warnings),
    )


def unseen(experiment: Experiment, progress: Progress) -> Recording:
    """The same robot and instrument along another motion, with other noise.

    Args:
        experiment: Of the run.
        progress: Called with samples done and samples in all.

    Raises:
        TestbedError: The other motion cannot be simulated.
    """
    asked = experiment.motion
    duration = min(max(UNSEEN, 1.0 / asked.fundamental), asked.duration)
    motion = asked.model_copy(update={"duration": duration, "candidates": 1})
    other = experiment.model_copy(update={"motion": motion, "seed": experiment.seed + 1})
    return simulate(other, progress)


def _asked(run: Run) -> list[tuple[str, str]]:
    experiment = run.experiment
    assert experiment is not None
    motion, plate = experiment.motion, experiment.measurement
    errors = ", ".join(f"{k} {v:+.0%}" for k, v in plate.torque_constant_error.items())
    table, plant = experiment.identification, experiment.simulation
    n = run.tree.n
    joints = f"{n} joint{'s' if n > 1 else ''}: {', '.join(run.tree.names)}"
    gx, gy, gz = run.tree.gravity
    return [
        ("robot", f"{run.tree.name}, {joints}"),
        ("gravity", f"{gx:g} {gy:g} {gz:g} m/s^2 in the bedplate frame"),
        ("model file", Path(experiment.model).name),
        (
            "motion",
            f"{motion.duration:g} s, repeats at {motion.fundamental:g} Hz with {motion.harmonics} "
            f"harmonics, the best of {motion.candidates}",
        ),
        (
            "encoders",
            f"{plate.rate:g} samples a second, resolution {plate.encoder_resolution:g}, noise "
            f"{plate.encoder_noise:g} [rad or m]",
        ),
        (
            "bedplate",
            f"noise {plate.force_noise:g} N and {plate.moment_noise:g} N m a sample",
        ),
        (
            "drives",
            f"torque noise {plate.torque_noise:g} [N m or N]"
            + (f", torque constants off by {errors}" if errors else ""),
        ),
        ("kinematics", "sensed exactly" if plate.senses_kinematics else "from encoders only"),
        ("joint friction", "as in the model file" if plant.friction else "none"),
        (
            "simulation",
            f"steps of {plant.step:g} s; samples are "
            + ("means over their steps" if plate.averaged else "instants"),
        ),
        (
            "identification",
            f"low-pass on positions {table.position_cutoff} Hz, on rows {table.cutoff} Hz; joint "
            f"rows below {table.deadband:g} rad/s or m/s dropped; parameters that are zero in "
            + ("the model file known" if table.zeros else "the model file not known"),
        ),
    ]


def _origin(run: Run) -> list[tuple[str, str]]:
    facts = result(run)
    versions = ", ".join(f"{name} {number}" for name, number in facts["versions"].items())
    return [
        ("model's SHA-256", facts["model_sha256"]),
        ("seed", str(run.recording.facts["seed"])),
        ("versions", versions),
        ("again", "testbed run experiment.toml, with the file of the run folder"),
    ]
