"""Simulate a rig along a motion: plant on the bedplate, controller, sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from scipy.interpolate import make_interp_spline

from testbed.core.base.arrays import Array
from testbed.core.base.contents import sha256_of_file
from testbed.core.base.diagnostics import make_diagnostic
from testbed.core.base.errors import ExperimentError, SettingsError
from testbed.core.base.installation import package_versions
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.recordings.geometry import joint_geometry
from testbed.core.recordings.metadata import Metadata, vector_tuple
from testbed.core.recordings.recording import Recording
from testbed.core.robot.rotations import matrix_to_rpy
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.rig import Rig
from testbed.lab.experiment.sensors import ForcePlate, JointTorques
from testbed.lab.instruments.chain import measure, with_sensor_readings
from testbed.lab.simulation.controller import ReferenceMotion
from testbed.lab.simulation.effect import ForceFunction
from testbed.lab.simulation.gear_friction import Gears
from testbed.lab.simulation.plant import build_plant
from testbed.lab.simulation.rollout import (
    BlockCallback,
    Rollout,
    Sampling,
    simulate_motion,
)


@runtime_checkable
class RestToRestReference(ReferenceMotion, Protocol):
    """Motion that begins and ends at rest, with a periodic part from time zero."""

    @property
    def lead(self) -> float:
        """Duration of the start before time zero, and of the deceleration after the end [s]."""

    @property
    def end(self) -> float:
        """End of the periodic part [s]."""


@dataclass(frozen=True, eq=False)
class SampledMotion:
    """Quintic spline through the samples of a motion, at rest before and after.

    Attributes:
        samples: Times from zero, (M,) [s], and positions, (M, n) [rad or m]; at least six samples.
    """

    samples: Motion

    @property
    def period(self) -> float:
        """Duration [s]."""
        return float(self.samples.t[-1])

    @cached_property
    def _spline(self) -> Any:
        """Quintic spline through the positions."""
        return make_interp_spline(self.samples.t, self.samples.q, k=5)

    def at(self, t: Array) -> Motion:
        """Positions, velocities and accelerations at times t, (M,) [s].

        Before and after the motion, the first and the last position are held.
        """
        is_moving = (t >= 0) & (t <= self.period)
        rates = [
            is_moving[:, None] * self._spline(self.path_time(t), order)
            for order in (1, 2)
        ]
        return Motion(t, self._spline(self.path_time(t)), *rates)

    def path_time(self, t: Array) -> Array:
        """Times t clipped to the duration of the motion, (M,) [s]."""
        return np.clip(t, 0.0, self.period)


def simulate(
    rig: Rig,
    motion: ReferenceMotion | Motion,
    seconds: float = 60.0,
    seed: int = 0,
    *,
    progress: Progress = ignore_progress,
    watch: BlockCallback = ignore_progress,
    forces: ForceFunction | None = None,
    installed: int | None = None,
) -> Recording:
    """Simulate a robot on its bedplate along a motion, measured by the rig's sensors.

    Args:
        rig: Robot, plant and sensors.
        motion: Periodic motion from `random_motion` or `design`, a motion from rest to rest, or
            samples `Motion(t, q, qd, qdd)`, of which the positions are used.
        seconds: Length of the recording [s]; motions from rest to rest and samples define their
            own.
        seed: Seed of all noise.
        progress: Called with the number of finished samples and of all samples.
        watch: Called with the simulated states about once a second of simulation.
        forces: Function for joint forces in addition to motors, friction and the plant's effects,
            called before every step.
        installed: Seed of the constant signs and phases of sensor errors; default `seed`.

    Returns:
        Measured signals. `truth` holds the simulated states, which no estimator uses.

    Raises:
        ModelError: The robot has no model file, or MuJoCo's model of the robot differs from it.
        SettingsError: Values do not fit each other or the robot.
        SimulationDiverged: The robot did not follow the motion.
    """
    if not isinstance(rig, Rig):
        raise SettingsError(
            f"simulate(rig, motion): rig is a Rig, found a {type(rig).__name__}"
        )
    reference, begin, end = _reference_motion(rig, motion, seconds)
    sampling = Sampling(rig.rate, rig.steps(end), rig.averaged, rig.warm_up, begin)
    tree, model = rig.true_robot, rig.file
    gears = _gear_friction(rig, tree)
    plant = build_plant(
        model,
        tree,
        rig.step,
        changed_joints=tree.names,
        with_friction=rig.friction,
        effects=rig.plant,
        sensors=list(rig.mounted),
    )
    rollout = simulate_motion(
        plant,
        tree if rig.friction else tree.without_friction(),
        reference,
        end,
        rig.bandwidth,
        sampling,
        progress,
        watch,
        _total_forces(rig, tree, forces),
        gears,
    )
    metadata = _recording_metadata(rig, tree, rollout, seed)
    if isinstance(motion, RestToRestReference):
        metadata = replace(metadata, counted=(0.0, motion.end))
    return _measured_recording(rig, rollout, plant.tare, metadata, seed, installed)


def _reference_motion(
    rig: Rig, motion: ReferenceMotion | Motion, seconds: float
) -> tuple[ReferenceMotion, float, float]:
    """Reference of the controller, and the times at which the recording starts and ends [s].

    A motion from rest to rest defines its own start and end. Samples end at their last time or at
    `seconds`, whichever is earlier.

    Raises:
        SettingsError: The motion has another number of joints than the robot.
    """
    if isinstance(motion, RestToRestReference):
        return motion, -motion.lead, motion.end + motion.lead
    reference: ReferenceMotion = (
        SampledMotion(motion) if isinstance(motion, Motion) else motion
    )
    joints = reference.at(np.zeros(1)).q.shape[1]
    if joints != rig.robot.n:
        raise SettingsError(
            f"the motion is of {joints} joints, the robot has {rig.robot.n}"
        )
    return (
        reference,
        0.0,
        min(seconds, reference.period) if isinstance(motion, Motion) else seconds,
    )


def _total_forces(
    rig: Rig, tree: Tree, caller_forces: ForceFunction | None
) -> ForceFunction | None:
    """Function for the sum of the effects' joint forces and a caller's joint forces.

    The result is None if there are no forces.
    """
    effect_forces = [effect.force_function(tree, rig.step) for effect in rig.plant]
    functions = [each for each in (*effect_forces, caller_forces) if each is not None]
    if not functions:
        return None

    def total(time: float, q: Array, qd: Array, motor: Array) -> Array:
        return np.asarray(sum(each(time, q, qd, motor) for each in functions))

    return total


def _gear_friction(rig: Rig, tree: Tree) -> Gears | None:
    """Gear friction that is solved together with the motion; None without such an effect.

    Raises:
        ExperimentError: Two effects replace the friction of the joints, or joints are coupled.
    """
    owners = [effect.kind for effect in rig.plant if effect.owns_friction]
    if len(owners) > 1:
        raise ExperimentError(
            f"{' and '.join(owners)} both take the place of the joints' own friction: choose one"
        )
    gear_frictions = [
        friction
        for effect in rig.plant
        if (friction := effect.gear_friction(tree)) is not None
    ]
    if gear_frictions and tree.shafts:
        raise ExperimentError(
            f"{owners[0]} is of joints with gears of their own, not of couplings"
        )
    return gear_frictions[0] if gear_frictions else None


def _measured_recording(
    rig: Rig,
    rollout: Rollout,
    tare: Array,
    metadata: Metadata,
    seed: int,
    installed: int | None,
) -> Recording:
    """Recording of a simulated motion by the rig's sensors.

    It contains the temperature if an effect models it. Torque and wrench are absent without a
    sensor for them.

    Args:
        rig: Robot, plant and sensors.
        rollout: Simulated true signals.
        tare: Static wrench of the pedestal, (6,) [N, N m].
        metadata: Metadata of the recording.
        seed: Seed of all noise.
        installed: Seed of the constant signs and phases of sensor errors; default `seed`.
    """
    names, time = rig.robot.names, rollout.time
    recording = measure(
        rig.instrument, names, time, rollout.truth, tare, metadata, seed, installed
    )
    for effect in rig.plant:
        temperature = effect.temperature(time)
        if temperature is not None:
            recording = replace(
                recording,
                temperature=np.broadcast_to(temperature, recording.position.shape),
            )
    instruments = {
        sensor.name: rig.instrument_of(plate) for sensor, plate in rig.mounted.items()
    }
    if instruments:
        recording = with_sensor_readings(recording, instruments, seed, installed)
    kinds = [type(sensor) for sensor in rig.outer]
    if JointTorques not in kinds:
        recording = replace(recording, torque=None)
    return (
        recording if ForcePlate in kinds else replace(recording, wrench=None, tare=None)
    )


def _recording_metadata(rig: Rig, tree: Tree, rollout: Rollout, seed: int) -> Metadata:
    """Metadata of a simulated recording.

    It contains the robot, gravity, geometry, hash of the model file, placements of the force
    sensors, seed, versions, rms tracking errors, and a diagnostic for each joint that reached its
    torque limit.
    """
    saturated = (
        make_diagnostic("motion.saturated", name, share)
        for name, share in zip(tree.names, rollout.saturated_fraction, strict=True)
        if share
    )
    places = {
        sensor.name: {
            "link": sensor.link,
            "position": sensor.position.tolist(),
            "rpy": list(matrix_to_rpy(sensor.rotation)),
        }
        for sensor in rig.mounted
    }
    tracking = dict(zip(tree.names, rollout.tracking_error.tolist(), strict=True))
    return Metadata(
        robot=tree.name,
        gravity=vector_tuple(tree.gravity),
        geometry=joint_geometry(tree),
        sensors=places,
        diagnostics=tuple(saturated),
        model_sha256=sha256_of_file(rig.file.path),
        others={"seed": seed, "versions": package_versions(), "tracking_rms": tracking},
    )
