"""Closed-loop simulation of a robot along a motion, logged sample by sample.

After a step MuJoCo's arrays hold mixed times: sensor data belong to the state before the step,
forces to the last stage of the integrator. Every logged instant is therefore computed again, with
the torque and the forces of its step. Averaged samples are means over the sample for all channels,
with constant torque; their acceleration is the change of velocity over the sample.
"""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import mujoco
import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import TestbedError
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.recordings.recording import Truth
from testbed.core.robot.formats.mjcf_compile import suppress_step_warnings
from testbed.core.robot.tree import Tree
from testbed.lab.simulation.compiled_loop import (
    Clock,
    Engine,
    Log,
    State,
    mujoco_functions,
    simulate_samples,
)
from testbed.lab.simulation.controller import (
    Controller,
    ReferenceMotion,
    computed_torque,
)
from testbed.lab.simulation.effect import ForceFunction
from testbed.lab.simulation.gear_friction import Gears, solve_friction
from testbed.lab.simulation.plant import Plant

MAX_SMOOTH_STEP = 1e-3
"""Longest integration step without stick or reversal at any joint [s]."""

MAX_DECAY_FRACTION = 0.2
"""Longest such step, as a fraction of the shortest time constant of damping and springs."""


@dataclass(frozen=True)
class Sampling:
    """Sampling of a simulated run.

    Attributes:
        rate: Sampling rate, also the controller's rate [Hz].
        steps: Integration steps per sample; fewer are used where no joint sticks or reverses and no
            force is discontinuous.
        averaged: True if a sample is the mean over its duration (integrate and dump), False if it
            is the value at its first instant.
        warm_up: Simulated time before the recording starts [s].
        start_time: Start time of the recording, 0 or earlier [s].
    """

    rate: float
    steps: int
    averaged: bool
    warm_up: float
    start_time: float = 0.0


class SampledLoop:
    """Closed-loop simulation of a motion, in blocks of samples."""

    def __init__(
        self,
        plant: Plant,
        drive: Controller,
        sampling: Sampling,
        forces: ForceFunction | None = None,
        gears: Gears | None = None,
    ) -> None:
        """Set the plant to the initial state of the reference.

        Args:
            plant: The robot on its bedplate.
            drive: The controller.
            sampling: Sampling of the run.
            forces: Function for additional joint forces, called before every step; None for none.
            gears: Load-dependent gear friction, solved before every step; None for none.
        """
        self._plant, model = plant, plant.model
        self._data = data = mujoco.MjData(model)
        data.qpos[:] = (
            plant.velocity_ratios @ drive.q[0]
        )  # every joint has one position
        data.qvel[:] = plant.velocity_ratios @ drive.qd[0]
        mujoco.mj_forward(model, data)
        self._rate, period = sampling.rate, 1 / sampling.rate
        smooth = 0 if forces or gears else _smooth_step_count(model, period)
        smooth = smooth if smooth < sampling.steps else 0
        self._smooth_model = copy.copy(model)
        option = self._smooth_model.opt
        option.timestep = period / max(smooth, 1)
        # keep the friction's time constant at the longer step
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_REFSAFE)
        self._force_callback = _ForceCallback(forces, gears, plant, data)
        self._engine = Engine(
            **mujoco_functions(),
            model=model._address,
            smooth_model=self._smooth_model._address,
            data=data._address,
            force_callback=self._force_callback.address,
        )
        self._state = State(
            position=data.qpos,
            velocity=data.qvel,
            acceleration=data.qacc,
            motor=data.ctrl,
            applied_force=data.qfrc_applied,
            sensor_data=data.sensordata,
            passive_force=data.qfrc_passive,
            constraint_force=data.qfrc_constraint,
            dry_friction=model.dof_frictionloss,
            order=plant.velocity_index,
            saved_state=np.zeros((2, model.nv)),
        )
        self._drive = drive
        self._clock = Clock(period, sampling.steps, smooth, sampling.averaged)

    def run(self, samples: range) -> Truth:
        """Simulate the next samples along the reference, and return the true signals.

        The plant continues from its state after the previous call. An exception in the function for
        additional forces is raised again.

        Args:
            samples: Sample indices that follow those of the previous call.
        """
        plant, model, n = (
            self._plant,
            self._plant.model,
            len(self._plant.velocity_index),
        )
        torque, velocity, acceleration = np.zeros((3, len(samples), n))
        sensor_data, losses = (
            np.zeros((len(samples), model.nsensordata)),
            np.zeros((len(samples), model.nv)),
        )
        log = Log(torque, velocity, acceleration, sensor_data, losses)
        simulate_samples(
            self._engine,
            self._state,
            self._drive,
            self._clock,
            log,
            samples.start,
            self._force_callback.failed,
        )
        self._force_callback.check()
        if self._clock.averaged:
            next_velocity = np.vstack(
                [velocity[1:], self._data.qvel[plant.velocity_index]]
            )
            acceleration = (next_velocity - velocity) * self._rate
        return Truth(
            position=sensor_data[:, plant.position_index],
            velocity=sensor_data[:, plant.velocity_sensor_index],
            acceleration=acceleration,
            torque=torque,
            friction=-losses @ plant.velocity_ratios,
            wrench=plant.X_BS.wrench(sensor_data[:, plant.plate_index]),
            sensors=sensor_data[:, plant.force_sensor_index],
        )


def _smooth_step_count(model: mujoco.MjModel, period: float) -> int:
    """Number of integration steps per sample where forces are smooth.

    A step is at most `MAX_SMOOTH_STEP`, and at most `MAX_DECAY_FRACTION` divided by the fastest
    rate of damping (damping / inertia) or of springs (natural frequency).

    Args:
        model: MuJoCo's model.
        period: Duration of a sample [s].
    """
    inverse_inertia = model.dof_invweight0
    spring = model.jnt_stiffness[model.dof_jntid]
    fastest_rate = max(
        np.max(model.dof_damping * inverse_inertia),
        np.sqrt(np.max(spring * inverse_inertia)),
    )
    return int(
        np.ceil(
            period
            / min(MAX_SMOOTH_STEP, MAX_DECAY_FRACTION / max(fastest_rate, 1e-9))
            * (1 - 1e-9)
        )
    )


class _ForceCallback:
    """C callback that applies additional forces and gear friction before every step.

    Its address is 0 if there are no such forces. An exception sets `failed`, which stops the
    compiled loop; `check` raises the exception.
    """

    def __init__(
        self,
        forces: ForceFunction | None,
        gears: Gears | None,
        plant: Plant,
        data: mujoco.MjData,
    ) -> None:
        self.failed, self.address = np.zeros(1, dtype=bool), 0
        self._error: BaseException | None = None
        if forces is None and gears is None:
            return
        order, applied = plant.velocity_index, data.qfrc_applied
        gear_friction = None if gears is None else _gear_friction(gears, plant, data)

        def push(time: float) -> None:
            try:
                state = data.qpos[order], data.qvel[order], data.ctrl.copy()
                applied[order] = 0.0 if forces is None else forces(time, *state)
                if gear_friction is not None:
                    applied[order] -= gear_friction()
            except BaseException as error:
                self._error, self.failed[0] = error, True

        self._callback = ctypes.CFUNCTYPE(None, ctypes.c_double)(push)
        self.address = ctypes.cast(self._callback, ctypes.c_void_p).value or 0

    def check(self) -> None:
        """Raise the exception that occurred in the callback, if any."""
        if self._error is not None:
            raise self._error


def _gear_friction(
    gears: Gears, plant: Plant, data: mujoco.MjData
) -> Callable[[], Array]:
    """Function for the gear friction over the next step, (n,) [N m or N].

    Each call solves the equation of `solve_friction` for the other joint forces at MuJoCo's current
    state, starting from the friction of the previous call.

    Args:
        gears: Friction coefficients of the gears.
        plant: The robot on its bedplate.
        data: MuJoCo's state.
    """
    model, order = plant.model, plant.velocity_index
    rotor, friction = model.dof_armature[order].copy(), np.zeros(len(order))
    masses = np.zeros((model.nv, model.nv))

    def solved_friction() -> Array:
        mujoco.mj_fullM(model, data, masses)
        inverse_mass = np.linalg.inv(masses)
        force = data.qfrc_applied.copy()
        force[order] += data.ctrl
        free_acceleration = inverse_mass @ (force + data.qfrc_passive - data.qfrc_bias)
        joint_inverse_mass = np.ascontiguousarray(inverse_mass[np.ix_(order, order)])
        state = (
            data.qvel[order],
            free_acceleration[order],
            joint_inverse_mass,
            force[order],
            rotor,
        )
        solve_friction(gears, model.opt.timestep, *state, friction)
        return friction

    return solved_friction


_BLOCK_SAMPLES = 1000
"""Number of samples between two reports of progress."""


BlockCallback: TypeAlias = Callable[[Array, Truth], None]
"""Function that takes the times and true signals of a block of samples."""


class SimulationDiverged(TestbedError):
    """Error: the simulation departed from the reference or became unstable."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """Result of a simulated run.

    Attributes:
        time: First instant of each sample, (M,) [s], without the warm-up.
        truth: Sampled true signals.
        tracking_error: Rms tracking error of each joint, (n,) [rad or m].
        saturated_fraction: Fraction of samples at the torque limit of each joint, (n,).
    """

    time: Array
    truth: Truth
    tracking_error: Array
    saturated_fraction: Array


def simulate_motion(
    plant: Plant,
    tree: Tree,
    motion: ReferenceMotion,
    duration: float,
    bandwidth: float,
    sampling: Sampling,
    progress: Progress = ignore_progress,
    report_block: BlockCallback = ignore_progress,
    forces: ForceFunction | None = None,
    gears: Gears | None = None,
) -> Rollout:
    """Simulate a motion under computed-torque control, in blocks of samples.

    Args:
        plant: The robot on its bedplate.
        tree: A-priori model of the robot and its friction, used by the controller.
        motion: Reference motion.
        duration: Duration of the recording from t = 0 [s].
        bandwidth: Bandwidth of the controller [rad/s].
        sampling: Sampling of the run.
        progress: Called with the number of finished samples and of all samples.
        report_block: Called with blocks of about a second of true signals, including those before t
            = 0.
        forces: Function for additional joint forces, called before every step; they are not part of
            the controller's model, and are recorded as friction with opposite sign.
        gears: Load-dependent gear friction, solved before every step; it replaces the plant's
            friction.

    Raises:
        SimulationDiverged: The simulation became unstable, or the rms tracking error of a joint is
            larger than its range of motion.
    """
    lead, samples = (
        round(sampling.warm_up * sampling.rate),
        round(duration * sampling.rate),
    )
    times = (
        np.arange(round(sampling.start_time * sampling.rate) - lead, samples)
        / sampling.rate
    )
    drive = computed_torque(tree, motion, times, bandwidth)
    loop, logs = SampledLoop(plant, drive, sampling, forces, gears), []
    for first in range(0, len(times), _BLOCK_SAMPLES):
        last = min(first + _BLOCK_SAMPLES, len(times))
        with suppress_step_warnings():  # a diverged state is detected below
            logs.append(loop.run(range(first, last)))
        if not all(np.isfinite(values).all() for values in vars(logs[-1]).values()):
            raise SimulationDiverged(
                f"the simulation became unstable near t = {times[last - 1]:.2f} s; use a "
                "smaller step or a lower drive bandwidth"
            )
        progress(last, len(times))
        report_block(times[first:last], logs[-1])
    return _checked_rollout(times[lead:], logs, drive, tree)


def _checked_rollout(
    time: Array, logs: Sequence[Truth], drive: Controller, tree: Tree
) -> Rollout:
    """Rollout of the recorded samples, after a check of the tracking errors.

    Args:
        time: First instants of the recorded samples, (M,) [s].
        logs: True signals of the blocks, including the warm-up.
        drive: The controller.
        tree: The robot, for joint names.

    Raises:
        SimulationDiverged: The rms tracking error of a joint is larger than its range of motion.
    """
    count = len(time)
    whole = {
        k: np.concatenate([vars(log)[k] for log in logs])[-count:]
        for k in vars(logs[0])
    }
    truth, reference = Truth(**whole), drive.q[-count:]
    tracking = np.sqrt(np.mean((truth.position - reference) ** 2, axis=0))
    motion_range = np.ptp(reference, axis=0)
    lost_joints = [
        name
        for name, e, s in zip(tree.names, tracking, motion_range, strict=True)
        if e > s
    ]
    if lost_joints:
        raise SimulationDiverged(
            f"the drive lost the reference at {', '.join(lost_joints)}; lower the motion's limits"
        )
    at_limit = np.abs(truth.torque) >= drive.effort * (1 - 1e-12)
    return Rollout(time, truth, tracking, at_limit.mean(axis=0))
