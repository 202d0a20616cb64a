"""What was asked for, and where a report comes from: facts with their names, in order."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from testbed.errors import plural
from testbed.experiment.experiment import Experiment
from testbed.experiment.experiment_tables import MotionTable
from testbed.experiment.run import Run
from testbed.experiment.versions import versions
from testbed.reporting.choice_table import choice_lines
from testbed.robot.free_base import FREE

Facts = list[tuple[str, str]]


def asked(run: Run) -> Facts:
    """Robot, motion, instruments and how the signals were treated.

    Args:
        run: The run.
    """
    names = run.tree.names[FREE:] if run.tree.floating else run.tree.names
    joints = f"{plural(len(names), 'joint')}: {', '.join(names)}"
    base = ", on a base that moves and whose pose is measured" if run.tree.floating else ""
    gx, gy, gz = run.tree.gravity
    facts = [
        ("robot", f"{run.tree.name}{base}, {joints}"),
        ("gravity", f"{gx:g} {gy:g} {gz:g} m/s^2 in the bedplate frame"),
    ]
    if run.model is not None:
        facts.append(("model file", run.model.path.name))
        facts += [("held", held)] if (held := _held(run.model.lock)) else []
    facts += _of_recording(run) if run.experiment is None else _of_experiment(run.experiment)
    chosen = [("terms", line) for line in choice_lines(run.estimates.values())]
    return [*facts, ("identification", _treatment(run)), *chosen]


def _held(lock: Mapping[str, float | None]) -> str:
    """Joints that do not move in this run, and where they stand."""
    at = {joint: "where it rests" if q is None else f"at {q:g}" for joint, q in lock.items()}
    unit = " [rad or m]" if any(q is not None for q in lock.values()) else ""
    return ", ".join(f"{joint} {place}" for joint, place in at.items()) + unit


def _of_recording(run: Run) -> Facts:
    """What a recording says of itself."""
    recording = run.recording
    duration = float(recording.time[-1] - recording.time[0])
    signals = {
        "bedplate wrench": recording.wrench,
        "joint torques": recording.torque,
        "velocities": recording.velocity,
        "accelerations": recording.acceleration,
    }
    there = ["joint positions", *(["pose of the base"] if run.tree.floating else [])]
    there += [name for name, signal in signals.items() if signal is not None]
    return [
        ("recording", f"{duration:.4g} s, {recording.rate:.5g} samples a second"),
        ("measured", ", ".join(there)),
    ]


def _of_experiment(experiment: Experiment) -> Facts:
    """Motion, instruments and plant, as they were asked for."""
    motion, plate, plant = experiment.motion, experiment.measurement, experiment.simulation
    errors = ", ".join(f"{k} {v:+.0%}" for k, v in plate.torque_constant_error.items())
    return [
        ("motion", _motion(motion)),
        (
            "encoders",
            f"{plate.rate:g} samples a second, resolution {plate.encoder_resolution:g}, noise "
            f"{plate.encoder_noise:g} [rad or m]",
        ),
        ("bedplate", f"noise {plate.force_noise:g} N and {plate.moment_noise:g} N m a sample"),
        ("faults", ", ".join(fault.kind for fault in plate.fault) or "none"),
        (
            "drives",
            f"torque noise {plate.torque_noise:g} [N m or N]"
            + (f", torque constants off by {errors}" if errors else ""),
        ),
        ("kinematics", "sensed exactly" if plate.senses_kinematics else "from encoders only"),
        ("joint friction", "as in the model file" if plant.friction else "none"),
        ("effects in the plant", ", ".join(effect.kind for effect in plant.effect) or "none"),
        (
            "simulation",
            f"steps of {plant.step:g} s; samples are "
            + ("means over their steps" if plate.averaged else "instants"),
        ),
    ]


def _treatment(run: Run) -> str:
    """How the signals became equations."""
    settings = run.settings.fitted(run.recording.rate)
    cutoffs = [
        cutoff if isinstance(cutoff, str) else f"{cutoff:g} Hz"
        for cutoff in (settings.position_cutoff, settings.cutoff)
    ]
    zeros = {True: "those that are zero in the model file", False: "none"}
    known = zeros[settings.zeros] if isinstance(settings.zeros, bool) else ", ".join(settings.zeros)
    taken = {"ar": "an autoregression", "white": "white"}[settings.noise]
    unknown = f"; unknown of the instrument: {', '.join(settings.nuisances)}" * bool(
        settings.nuisances
    )
    dropped = f"joint rows below {settings.deadband:g} rad/s or m/s dropped; "
    return (
        f"low-pass on positions {cutoffs[0]}, on rows {cutoffs[1]}; "
        f"{'' if run.tree.floating else dropped}noise taken for {taken}; parameters "
        f"known to be zero: {known}{unknown}"
    )


def origin(run: Run) -> Facts:
    """Files, versions, and how to repeat it.

    Args:
        run: The run.
    """
    facts = [("versions", ", ".join(f"{name} {number}" for name, number in versions().items()))]
    known = run.recording.facts
    if known.get("model_sha256"):
        facts.insert(0, ("model's SHA-256", str(known["model_sha256"])))
    if run.experiment is not None:
        facts.append(("seed", str(run.experiment.seed)))
        facts.append(("again, in the run folder", "testbed run experiment.toml"))
    return facts


def _motion(motion: MotionTable) -> str:
    rests = ", from rest to rest" if motion.at_rest else ""
    if motion.file:
        return f"{motion.duration:g} s of the one in {Path(motion.file).name}{rests}"
    return (
        f"{motion.duration:g} s, repeats at {motion.fundamental:g} Hz with {motion.harmonics} "
        f"harmonics, the best of {motion.candidates}{rests}"
    )
