"""Roll out a robot along its motion and log what happens, sample by sample.

What MuJoCo holds after a step is a mixture: sensors belong to the state before it, forces
to the last stage of the integrator. Every instant that counts is therefore computed anew, under
the torque and the forces of its own step. Averaged samples are means over the sample of every
channel alike, the torque held over it; their acceleration is the gain of velocity.
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
from testbed.core.base.stages import Progress, unreported
from testbed.core.recordings.recording import Truth
from testbed.core.robot.formats.mjcf_compile import unwarned_steps
from testbed.core.robot.tree import Tree
from testbed.lab.simulation.compiled_loop import (
    Clock,
    Engine,
    Log,
    State,
    follow,
    mujoco_functions,
)
from testbed.lab.simulation.controller import Controller, Reference, computed_torque
from testbed.lab.simulation.effect import StepForces
from testbed.lab.simulation.gear_friction import Gears, solve_friction
from testbed.lab.simulation.plant import Plant

SMOOTH_STEP = 1e-3
"""Longest step where no joint sticks or turns round [s]."""

SMOOTH_DECAY = 0.2
"""Part of the shortest time in which damping or a spring acts that such a step may last."""


@dataclass(frozen=True)
class Sampling:
    """How a run is cut into samples.

    Attributes:
        rate: Samples a second, also the controller's rate [Hz].
        steps: Simulation steps a sample; fewer are taken where no joint sticks or turns round,
            and no force jumps.
        averaged: Each sample is the mean over its time (integrate and dump), else its
            first instant.
        warm_up: Time run before the recording starts [s].
        begin: When the recording begins, 0 or earlier [s].
    """

    rate: float
    steps: int
    averaged: bool
    warm_up: float
    begin: float = 0.0


class SampledLoop:
    """One run, some samples after others."""

    def __init__(
        self,
        plant: Plant,
        drive: Controller,
        sampling: Sampling,
        forces: StepForces | None = None,
        gears: Gears | None = None,
    ) -> None:
        """At the beginning of the reference.

        Args:
            plant: The robot on its bedplate.
            drive: Its controller.
            sampling: How the run is cut into samples.
            forces: Asked before every step.
            gears: Whose friction is solved before every step.
        """
        self._plant, model = plant, plant.model
        self._data = data = mujoco.MjData(model)
        data.qpos[:] = plant.dofs @ drive.q[0]  # every joint has one position
        data.qvel[:] = plant.dofs @ drive.qd[0]
        mujoco.mj_forward(model, data)
        self._rate, period = sampling.rate, 1 / sampling.rate
        smooth = 0 if forces or gears else _smooth_steps(model, period)
        smooth = smooth if smooth < sampling.steps else 0
        self._smooth_model = copy.copy(model)
        option = self._smooth_model.opt
        option.timestep = period / max(smooth, 1)
        # friction as it is
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_REFSAFE)
        self._push = _Push(forces, gears, plant, data)
        self._engine = Engine(
            **mujoco_functions(),
            model=model._address,
            smooth_model=self._smooth_model._address,
            data=data._address,
            push=self._push.address,
        )
        self._state = State(
            position=data.qpos,
            velocity=data.qvel,
            acceleration=data.qacc,
            motor=data.ctrl,
            pushed=data.qfrc_applied,
            sensed=data.sensordata,
            passive=data.qfrc_passive,
            constraint=data.qfrc_constraint,
            dry=model.dof_frictionloss,
            order=plant.order,
            kept=np.zeros((2, model.nv)),
        )
        self._drive = drive
        self._clock = Clock(period, sampling.steps, smooth, sampling.averaged)

    def run(self, samples: range) -> Truth:
        """Follow the next samples of the reference.

        Args:
            samples: Their numbers.
        """
        plant, model, n = self._plant, self._plant.model, len(self._plant.order)
        torque, velocity, acceleration = np.zeros((3, len(samples), n))
        sensed, lost = (
            np.zeros((len(samples), model.nsensordata)),
            np.zeros((len(samples), model.nv)),
        )
        log = Log(torque, velocity, acceleration, sensed, lost)
        follow(
            self._engine,
            self._state,
            self._drive,
            self._clock,
            log,
            samples.start,
            self._push.failed,
        )
        self._push.check()
        if self._clock.averaged:
            later = np.vstack([velocity[1:], self._data.qvel[plant.order]])
            acceleration = (later - velocity) * self._rate
        return Truth(
            position=sensed[:, plant.positions],
            velocity=sensed[:, plant.velocities],
            acceleration=acceleration,
            torque=torque,
            friction=-lost @ plant.dofs,
            wrench=plant.X_BS.wrench(sensed[:, plant.plate]),
            sensors=sensed[:, plant.sensors],
        )


def _smooth_steps(model: mujoco.MjModel, period: float) -> int:
    """Steps that a smooth sample needs, for the fastest of what damps or springs."""
    loose = model.dof_invweight0
    spring = model.jnt_stiffness[model.dof_jntid]
    fastest = max(np.max(model.dof_damping * loose), np.sqrt(np.max(spring * loose)))
    return int(
        np.ceil(
            period / min(SMOOTH_STEP, SMOOTH_DECAY / max(fastest, 1e-9)) * (1 - 1e-9)
        )
    )


class _Push:
    """Forces on the joints, as C calls them; an error waits until the loop has ended."""

    def __init__(
        self,
        forces: StepForces | None,
        gears: Gears | None,
        plant: Plant,
        data: mujoco.MjData,
    ) -> None:
        self.failed, self.address = np.zeros(1, dtype=bool), 0
        self._error: BaseException | None = None
        if forces is None and gears is None:
            return
        order, applied = plant.order, data.qfrc_applied
        rub = None if gears is None else _gear_friction(gears, plant, data)

        def push(time: float) -> None:
            try:
                state = data.qpos[order], data.qvel[order], data.ctrl.copy()
                applied[order] = 0.0 if forces is None else forces(time, *state)
                if rub is not None:
                    applied[order] -= rub()
            except BaseException as error:
                self._error, self.failed[0] = error, True

        self._callback = ctypes.CFUNCTYPE(None, ctypes.c_double)(push)
        self.address = ctypes.cast(self._callback, ctypes.c_void_p).value or 0

    def check(self) -> None:
        """Raise what a push has raised."""
        if self._error is not None:
            raise self._error


def _gear_friction(
    gears: Gears, plant: Plant, data: mujoco.MjData
) -> Callable[[], Array]:
    """What gears take over the next step, beside the forces that act otherwise, (n,)."""
    model, order = plant.model, plant.order
    rotor, friction = model.dof_armature[order].copy(), np.zeros(len(order))
    masses = np.zeros((model.nv, model.nv))

    def taken() -> Array:
        mujoco.mj_fullM(model, data, masses)
        loose = np.linalg.inv(masses)
        force = data.qfrc_applied.copy()
        force[order] += data.ctrl
        free = loose @ (force + data.qfrc_passive - data.qfrc_bias)
        own = np.ascontiguousarray(loose[np.ix_(order, order)])
        state = data.qvel[order], free[order], own, force[order], rotor
        solve_friction(gears, model.opt.timestep, *state, friction)
        return friction

    return taken


_SLAB = 1000
"""Samples between two reports of progress."""


Watch: TypeAlias = Callable[[Array, Truth], None]


class SimulationDiverged(TestbedError):
    """The simulation left the reference or became unstable."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """What happened in a simulated run.

    Attributes:
        time: First instant of each sample, (M,) [s].
        truth: What happened, sampled.
        tracking: Rms distance from the reference, (n,) [rad or m].
        saturated: Share of samples at the effort limit, (n,).
    """

    time: Array
    truth: Truth
    tracking: Array
    saturated: Array


def simulate_motion(
    plant: Plant,
    tree: Tree,
    motion: Reference,
    duration: float,
    bandwidth: float,
    sampling: Sampling,
    progress: Progress = unreported,
    watch: Watch = unreported,
    forces: StepForces | None = None,
    gears: Gears | None = None,
) -> Rollout:
    """Follow a motion in closed loop.

    Args:
        plant: The robot on its bedplate.
        tree: The drive's own model of the robot and its friction.
        motion: The reference.
        duration: Of the recording, from t = 0 to its end [s].
        bandwidth: Of the drive [rad/s].
        sampling: How the run is cut into samples.
        progress: Called with samples done and samples in all.
        watch: Called with every second or so of what happens, times before 0 included.
        forces: Asked before every step; what they take counts as friction. The drive does
            not know of them.
        gears: Whose friction is solved before every step, in place of the plant's.

    Raises:
        SimulationDiverged: The robot did not follow.
    """
    lead, samples = (
        round(sampling.warm_up * sampling.rate),
        round(duration * sampling.rate),
    )
    times = (
        np.arange(round(sampling.begin * sampling.rate) - lead, samples) / sampling.rate
    )
    drive = computed_torque(tree, motion, times, bandwidth)
    loop, logs = SampledLoop(plant, drive, sampling, forces, gears), []
    for first in range(0, len(times), _SLAB):
        last = min(first + _SLAB, len(times))
        with unwarned_steps():  # a state that blows up is found below
            logs.append(loop.run(range(first, last)))
        if not all(np.isfinite(values).all() for values in vars(logs[-1]).values()):
            raise SimulationDiverged(
                f"the simulation became unstable near t = {times[last - 1]:.2f} s; use a "
                "smaller step or a lower drive bandwidth"
            )
        progress(last, len(times))
        watch(times[first:last], logs[-1])
    return _rollout_of(times[lead:], logs, drive, tree)


def _rollout_of(
    time: Array, logs: Sequence[Truth], drive: Controller, tree: Tree
) -> Rollout:
    count = len(time)
    whole = {
        k: np.concatenate([vars(log)[k] for log in logs])[-count:]
        for k in vars(logs[0])
    }
    truth, wanted = Truth(**whole), drive.q[-count:]
    tracking = np.sqrt(np.mean((truth.position - wanted) ** 2, axis=0))
    swing = np.ptp(wanted, axis=0)
    lost = [
        name for name, e, s in zip(tree.names, tracking, swing, strict=True) if e > s
    ]
    if lost:
        raise SimulationDiverged(
            f"the drive lost the reference at {', '.join(lost)}; lower the motion's limits"
        )
    at_limit = np.abs(truth.torque) >= drive.effort * (1 - 1e-12)
    return Rollout(time, truth, tracking, at_limit.mean(axis=0))
