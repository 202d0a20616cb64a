"""Compiled simulation loop over samples: controller and MuJoCo's functions by address.

In Python a sample would take longer than MuJoCo's integration of it.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.kernel.compiler import call_address, compiled_entry, compiled_function
from testbed.lab.simulation.controller import DAMPING, Controller

SLIP_TOLERANCE = 1e-6
"""Relative tolerance between MuJoCo's friction force and dry friction of a joint that slips."""

MIN_SPEED_CHANGES = 2.0
"""Smallest speed of a joint that is taken to slip for a whole sample, in changes of speed per
sample: a slower joint may reverse."""


class Engine(NamedTuple):
    """Addresses of MuJoCo's functions and structures, and of the force callback.

    The function at `force_callback` applies forces to the joints; the address is 0 if there is
    none.
    """

    runge_kutta: int
    forward: int
    forward_skip: int
    model: int
    smooth_model: int  # copy of the model with a longer step
    data: int
    force_callback: int


class State(NamedTuple):
    """Views of MuJoCo's state arrays, with joint indices and a buffer.

    Arrays have one element per MuJoCo velocity, (nv,), except `motor`, with one per joint, and
    `sensor_data`.
    """

    position: Array
    velocity: Array
    acceleration: Array
    motor: Array
    applied_force: Array
    sensor_data: Array
    passive_force: Array
    constraint_force: Array
    dry_friction: Array  # dry friction by MuJoCo's velocities
    order: NDArray[np.int64]  # index of each joint's velocity
    saved_state: Array  # buffer for positions and velocities, (2, nv)


class Clock(NamedTuple):
    """Division of a sample into integration steps."""

    period: float  # duration of a sample [s]
    steps: int  # number of steps per sample
    smooth_steps: int  # number for a sample with smooth forces; 0 to use `steps`
    averaged: bool  # samples are means, else first instants


class Log(NamedTuple):
    """Logged signals, one row per sample.

    Torques, velocities and accelerations have one column per joint, losses one per MuJoCo velocity.
    """

    torque: Array
    velocity: Array  # at the first instant of the sample
    acceleration: Array  # at the first instant of the sample
    sensor_data: Array  # sums or first instants of the sensor data
    losses: Array  # passive, constraint and applied forces


def mujoco_functions() -> dict[str, int]:
    """Addresses of the MuJoCo functions that the loop calls, keyed by field of `Engine`."""
    library = ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("libmujoco.*"))))
    functions = {
        "runge_kutta": library.mj_RungeKutta,
        "forward": library.mj_forward,
        "forward_skip": library.mj_forwardSkip,
    }
    return {
        name: ctypes.cast(function, ctypes.c_void_p).value or 0
        for name, function in functions.items()
    }


@compiled_entry
def simulate_samples(
    engine: Engine,
    state: State,
    drive: Controller,
    clock: Clock,
    log: Log,
    first: int,
    stopped: NDArray[np.bool_],
) -> None:
    """Simulate the plant under computed torque, one sample per row of the log.

    The motor torque is constant over a sample. Means over a sample are computed by the trapezoidal
    rule. If all joints with dry friction slip, the sample is divided into `smooth_steps` longer
    steps, and means are computed by Simpson's rule, with the middle of a step interpolated from
    positions and velocities at its ends. The function returns early if the force callback has
    failed.

    Args:
        engine: Addresses of MuJoCo's functions and structures.
        state: State of the plant with derived values, at the first instant; on return, at the last.
        drive: The controller.
        clock: Division of a sample into steps.
        log: Signals, filled on return; sums must be zero initially.
        first: Number of the first sample.
        stopped: True if the force callback has failed, (1,).
    """
    for row in range(len(log.torque)):
        k = first + row
        torque = log.torque[row]
        motor_torque(drive, k, state.position, state.velocity, state.order, torque)
        _copy(torque, state.motor)
        if engine.force_callback:
            call_address(engine.force_callback, (drive.times[k],))
        call_address(
            engine.forward_skip, (engine.model, engine.data, np.int32(2), np.int32(0))
        )
        for i, joint in enumerate(state.order):
            log.velocity[row, i] = state.velocity[joint]
            log.acceleration[row, i] = state.acceleration[joint]
        model, steps, midpoint_weight = engine.model, clock.steps, 0.0
        if clock.smooth_steps and _has_smooth_forces(state, clock.period):
            model, steps, midpoint_weight = (
                engine.smooth_model,
                clock.smooth_steps,
                2 / 3,
            )
        step = clock.period / steps
        if not clock.averaged:
            _accumulate(state, log.sensor_data[row], log.losses[row], 1.0)
        for number in range(steps):
            if engine.force_callback and number:
                call_address(engine.force_callback, (drive.times[k] + number * step,))
                call_address(
                    engine.forward_skip, (model, engine.data, np.int32(2), np.int32(0))
                )
            if stopped[0]:
                return
            if clock.averaged:
                _accumulate(
                    state,
                    log.sensor_data[row],
                    log.losses[row],
                    (1 - midpoint_weight) / 2 / steps,
                )
            _copy(state.position, state.saved_state[0])
            _copy(state.velocity, state.saved_state[1])
            call_address(engine.runge_kutta, (model, engine.data, np.int32(4)))
            if clock.averaged and midpoint_weight:
                _interpolate_midpoint(state, step)
                call_address(engine.forward, (model, engine.data))
                _accumulate(
                    state,
                    log.sensor_data[row],
                    log.losses[row],
                    midpoint_weight / steps,
                )
                _copy(state.saved_state[0], state.position)
                _copy(state.saved_state[1], state.velocity)
            call_address(engine.forward, (model, engine.data))
            if clock.averaged:
                _accumulate(
                    state,
                    log.sensor_data[row],
                    log.losses[row],
                    (1 - midpoint_weight) / 2 / steps,
                )


@compiled_function
def motor_torque(
    drive: Controller,
    k: int,
    position: Array,
    velocity: Array,
    order: NDArray[np.int64],
    torque: Array,
) -> None:
    """Set the motor torques of a sample: computed torque, limited to the maximum effort.

    The torque before limiting is feedforward + M (w^2 e + 2 `DAMPING` w de/dt), with the mass
    matrix M, the bandwidth w and the position error e.

    Args:
        drive: The controller.
        k: Number of the sample.
        position: Positions, (nv,) [rad or m].
        velocity: Velocities, (nv,) [rad/s or m/s].
        order: Index of each joint among MuJoCo's positions and velocities, (n,).
        torque: Motor torques, set on return, (n,) [N m or N].
    """
    inertia, stiffness = drive.inertia[drive.mass_matrix_index[k]], drive.bandwidth**2
    damping = 2 * DAMPING * drive.bandwidth
    for i in range(len(order)):
        command = drive.feedforward[k, i]
        for j, index in enumerate(order):
            position_error, velocity_error = (
                drive.q[k, j] - position[index],
                drive.qd[k, j] - velocity[index],
            )
            command += inertia[i, j] * (
                stiffness * position_error + damping * velocity_error
            )
        torque[i] = min(max(command, -drive.effort[i]), drive.effort[i])


@compiled_function
def _copy(source: Array, target: Array) -> None:
    """Copy an array element by element, since the compiler does not support slices."""
    for i in range(len(source)):
        target[i] = source[i]


@compiled_function
def _has_smooth_forces(state: State, period: float) -> bool:
    """Test whether all joints with dry friction slip without reversal within a sample.

    A joint slips if MuJoCo's constraint force equals the dry friction within `SLIP_TOLERANCE`. It
    does not reverse if its speed exceeds `MIN_SPEED_CHANGES` times the change of speed over the
    sample.

    Args:
        state: State of the plant.
        period: Duration of a sample [s].
    """
    for i in range(len(state.dry_friction)):
        friction = state.dry_friction[i]
        if abs(abs(state.constraint_force[i]) - friction) > SLIP_TOLERANCE * friction:
            return False
        if friction and abs(state.velocity[i]) <= MIN_SPEED_CHANGES * period * abs(
            state.acceleration[i]
        ):
            return False
    return True


@compiled_function
def _interpolate_midpoint(state: State, step: float) -> None:
    """Set the state to the middle of a step by cubic Hermite interpolation.

    `state.saved_state` contains the beginning of the step; on return, it contains the end.
    """
    for i in range(len(state.position)):
        q, v = state.saved_state[0, i], state.saved_state[1, i]
        q_end, v_end = state.position[i], state.velocity[i]
        state.saved_state[0, i], state.saved_state[1, i] = q_end, v_end
        state.position[i] = (q + q_end) / 2 + step / 8 * (v - v_end)
        state.velocity[i] = 1.5 * (q_end - q) / step - (v + v_end) / 4


@compiled_function
def _accumulate(state: State, sensor_data: Array, losses: Array, weight: float) -> None:
    """Add weighted sensor data and force losses to the sums over a sample.

    Args:
        state: State of the plant.
        sensor_data: Sum of the sensor data, updated.
        losses: Sum of passive, constraint and applied forces, (nv,) [N m or N], updated.
        weight: Weight of this instant.
    """
    for i in range(len(sensor_data)):
        sensor_data[i] += weight * state.sensor_data[i]
    for i in range(len(losses)):
        losses[i] += weight * (
            state.passive_force[i] + state.constraint_force[i] + state.applied_force[i]
        )
