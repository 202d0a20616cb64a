"""The loop over samples in machine code: the controller's law, and MuJoCo by address.

Through Python a sample would cost more than what MuJoCo does in it.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.kernel.compiler import call, outer, plain
from testbed.lab.simulation.controller import DAMPING, Controller

SLIPS = 1e-6
"""Part of dry friction by which the force that MuJoCo finds may differ while a joint slips."""

TURNS = 2.0
"""Changes of speed in a sample that a slipping joint must be faster than, not to turn round."""


class Engine(NamedTuple):
    """Addresses: MuJoCo's functions and structures, and what pushes the joints (0 for nothing)."""

    runge_kutta: int
    forward: int
    forward_skip: int
    model: int
    smooth_model: int  # the same with another step
    data: int
    push: int


class State(NamedTuple):
    """MuJoCo's live arrays, and what belongs to them."""

    position: Array
    velocity: Array
    acceleration: Array
    motor: Array
    pushed: Array
    sensed: Array
    passive: Array
    constraint: Array
    dry: Array  # friction of each velocity
    order: NDArray[np.int64]  # which velocity is each joint's
    kept: Array  # room for positions and velocities, (2, nv)


class Clock(NamedTuple):
    """How samples are cut into steps."""

    period: float  # of a sample
    steps: int  # of a sample
    smooth_steps: int  # of a smooth one; 0 where none is taken for such
    averaged: bool


class Log(NamedTuple):
    """What happens, a row a sample."""

    torque: Array
    velocity: Array  # at its first instant
    acceleration: Array  # likewise
    sensed: Array
    lost: Array  # what passive forces, constraints and pushes add


def mujoco_functions() -> dict[str, int]:
    """Addresses of what the loop calls, by the names of `Engine`."""
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


@outer
def follow(
    engine: Engine,
    state: State,
    drive: Controller,
    clock: Clock,
    log: Log,
    first: int,
    stopped: NDArray[np.bool_],
) -> None:
    """Follow the reference for as many samples as the log has rows.

    The torque is held over a sample. Means over it are by the trapezoidal rule, and by Simpson's
    where it is smooth: then a step's middle follows from positions and velocities at its ends.

    Args:
        engine: What is called.
        state: Of the plant, at the first instant and afterwards at the last; derived values too.
        drive: The controller.
        clock: The samples.
        log: Filled; sums begin with zero.
        first: Number of the first sample.
        stopped: Whether a push has failed, (1,).
    """
    for row in range(len(log.torque)):
        k = first + row
        torque = log.torque[row]
        motor_torque(drive, k, state.position, state.velocity, state.order, torque)
        _copy(torque, state.motor)
        if engine.push:
            call(engine.push, (drive.times[k],))
        call(engine.forward_skip, (engine.model, engine.data, np.int32(2), np.int32(0)))
        for i, joint in enumerate(state.order):
            log.velocity[row, i] = state.velocity[joint]
            log.acceleration[row, i] = state.acceleration[joint]
        model, steps, middle = engine.model, clock.steps, 0.0
        if clock.smooth_steps and _smooth(state, clock.period):
            model, steps, middle = engine.smooth_model, clock.smooth_steps, 2 / 3
        step = clock.period / steps
        if not clock.averaged:
            _add(state, log.sensed[row], log.lost[row], 1.0)
        for number in range(steps):
            if engine.push and number:
                call(engine.push, (drive.times[k] + number * step,))
                call(
                    engine.forward_skip, (model, engine.data, np.int32(2), np.int32(0))
                )
            if stopped[0]:
                return
            if clock.averaged:
                _add(state, log.sensed[row], log.lost[row], (1 - middle) / 2 / steps)
            _copy(state.position, state.kept[0])
            _copy(state.velocity, state.kept[1])
            call(engine.runge_kutta, (model, engine.data, np.int32(4)))
            if clock.averaged and middle:
                _to_middle(state, step)
                call(engine.forward, (model, engine.data))
                _add(state, log.sensed[row], log.lost[row], middle / steps)
                _copy(state.kept[0], state.position)
                _copy(state.kept[1], state.velocity)
            call(engine.forward, (model, engine.data))
            if clock.averaged:
                _add(state, log.sensed[row], log.lost[row], (1 - middle) / 2 / steps)


@plain
def motor_torque(
    drive: Controller,
    k: int,
    position: Array,
    velocity: Array,
    order: NDArray[np.int64],
    torque: Array,
) -> None:
    """Motor torques for sample k within the limits of the motors; compiled.

    Args:
        drive: The controller.
        k: The sample.
        position: (nv,) [rad or m].
        velocity: (nv,) [rad/s or m/s].
        order: Where each joint's stand among these, (n,).
        torque: Set, (n,) [N m or N].
    """
    inertia, stiffness = drive.inertia[drive.posture[k]], drive.bandwidth**2
    damping = 2 * DAMPING * drive.bandwidth
    for i in range(len(order)):
        wanted = drive.expected[k, i]
        for j, at in enumerate(order):
            late, slow = drive.q[k, j] - position[at], drive.qd[k, j] - velocity[at]
            wanted += inertia[i, j] * (stiffness * late + damping * slow)
        torque[i] = min(max(wanted, -drive.effort[i]), drive.effort[i])


@plain
def _copy(source: Array, target: Array) -> None:
    """Number by number: slices would take what the compiler is asked to leave out."""
    for i in range(len(source)):
        target[i] = source[i]


@plain
def _smooth(state: State, period: float) -> bool:
    """Whether all that rubs slips, and goes on slipping for a sample: no force will jump."""
    for i in range(len(state.dry)):
        rubs = state.dry[i]
        if abs(abs(state.constraint[i]) - rubs) > SLIPS * rubs:
            return False
        if rubs and abs(state.velocity[i]) <= TURNS * period * abs(
            state.acceleration[i]
        ):
            return False
    return True


@plain
def _to_middle(state: State, step: float) -> None:
    """The instant amid a step, by Hermite's cubic through its ends; the end is kept."""
    for i in range(len(state.position)):
        q, v = state.kept[0, i], state.kept[1, i]
        q_end, v_end = state.position[i], state.velocity[i]
        state.kept[0, i], state.kept[1, i] = q_end, v_end
        state.position[i] = (q + q_end) / 2 + step / 8 * (v - v_end)
        state.velocity[i] = 1.5 * (q_end - q) / step - (v + v_end) / 4


@plain
def _add(state: State, sensed: Array, lost: Array, weight: float) -> None:
    """Add what sensors show and what takes from the motors, with a weight."""
    for i in range(len(sensed)):
        sensed[i] += weight * state.sensed[i]
    for i in range(len(lost)):
        lost[i] += weight * (state.passive[i] + state.constraint[i] + state.pushed[i])
