"""Roll out a robot along its motion and log what happens, sample by sample.

What MuJoCo holds after a step is a mixture: sensors belong to the state before it, forces
to the last stage of the integrator. Every instant that counts is therefore computed anew, under
the torque and the forces of its own step. Averaged samples are means over the sample of every
channel alike, the torque held over it; their acceleration is the gain of velocity.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import mujoco
import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import TestbedError
from testbed.core.recordings.recording import Truth
from testbed.core.robot.formats.mjcf_compile import unwarned_steps
from testbed.core.robot.tree import Tree
from testbed.lab.simulation.controller import Controller, Reference, computed_torque
from testbed.lab.simulation.effect import StepForces
from testbed.lab.simulation.gear_friction import Gears, solve_friction
from testbed.lab.simulation.plant import Plant

SMOOTH_STEP = 1e-3
"""Longest step where no joint sticks or turns round [s]."""

SMOOTH_DECAY = 0.2
"""Part of the shortest time in which damping or a spring acts that such a step may last."""

SLIPS = 1e-6
"""Part of dry friction by which the force that MuJoCo finds may differ while a joint slips."""

TURNS = 2.0
"""Changes of speed in a sample that a slipping joint must be faster than, not to turn round."""

MIDDLE = 2 / 3
"""Weight of a step's middle by Simpson's rule."""


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
        """Put the plant at the beginning of the reference.

        Args:
            plant: The robot on its bedplate.
            drive: Its controller.
            sampling: How the run is cut into samples.
            forces: Asked before every step.
            gears: Whose friction is solved before every step.
        """
        self._plant, self._drive, self._sampling = plant, drive, sampling
        self._data = data = mujoco.MjData(plant.model)
        data.qpos[:] = plant.dofs @ drive.q[0]  # every joint has one position
        data.qvel[:] = plant.dofs @ drive.qd[0]
        mujoco.mj_forward(plant.model, data)
        self._forces = forces
        self._rubbing = None if gears is None else _gear_friction(gears, plant, data)
        self._pushed = forces is not None or gears is not None
        self._smooth_steps = 0 if self._pushed else _smooth_steps(plant.model, sampling)
        self._smooth_model = copy.copy(plant.model)
        option = self._smooth_model.opt
        option.timestep = 1 / sampling.rate / max(self._smooth_steps, 1)
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_REFSAFE)  # friction as it is

    def run(self, samples: range) -> Truth:
        """Follow the next samples of the reference.

        Args:
            samples: Their numbers.
        """
        plant, rate = self._plant, self._sampling.rate
        logs = zip(*(self._sample(k) for k in samples), strict=True)
        torque, velocity, acceleration, shown = (np.array(log) for log in logs)
        sensed, lost = np.split(shown, [plant.model.nsensordata], axis=1)
        if self._sampling.averaged:
            later = np.vstack([velocity[1:], self._data.qvel[plant.order]])
            acceleration = (later - velocity) * rate
        return Truth(
            position=sensed[:, plant.positions],
            velocity=sensed[:, plant.velocities],
            acceleration=acceleration,
            torque=torque,
            friction=-lost @ plant.dofs,
            wrench=plant.bedplate_wrench(sensed[:, plant.plate]),
            sensors=sensed[:, plant.sensors],
        )

    def _sample(self, k: int) -> tuple[Array, Array, Array, Array]:
        """Torque, velocity and acceleration at the first instant; what is shown of the sample.

        Means are by the trapezoidal rule, and by Simpson's where the sample is smooth: then a
        step's middle follows from positions and velocities at its ends.
        """
        data, order, averaged = self._data, self._plant.order, self._sampling.averaged
        model, steps, middle = self._plant.model, self._sampling.steps, 0.0
        torque = self._drive.torque(k, data.qpos[order], data.qvel[order])
        data.ctrl[:] = torque
        self._push(k, 0.0)
        velocity, acceleration = data.qvel[order], data.qacc[order]
        if self._smooth_steps and self._slips():
            model, steps, middle = self._smooth_model, self._smooth_steps, MIDDLE
        step, edge = 1 / self._sampling.rate / steps, (1 - middle) / 2 / steps
        shown = np.zeros(len(data.sensordata) + len(data.qvel)) if averaged else self._shown()
        for number in range(steps):
            if number and self._pushed:
                self._push(k, number * step)
            if averaged:
                shown += edge * self._shown()
            before = data.qpos.copy(), data.qvel.copy()
            mujoco.mj_RungeKutta(model, data, 4)
            if averaged and middle:
                shown += middle / steps * self._shown_amid(*before, step)
            mujoco.mj_forward(model, data)
            if averaged:
                shown += edge * self._shown()
        return torque, velocity, acceleration, shown

    def _push(self, k: int, late: float) -> None:
        """Apply the forces of a step that begins so late in a sample; find accelerations."""
        data, order = self._data, self._plant.order
        if self._pushed:
            data.qfrc_applied[order] = 0.0
        if self._forces is not None:
            state = data.qpos[order], data.qvel[order], data.ctrl.copy()
            data.qfrc_applied[order] = self._forces(self._drive.times[k] + late, *state)
        if self._rubbing is not None:
            data.qfrc_applied[order] -= self._rubbing()
        mujoco.mj_forwardSkip(self._plant.model, data, mujoco.mjtStage.mjSTAGE_VEL, 0)

    def _slips(self) -> bool:
        """Whether all that rubs slips, and goes on slipping for a sample: no force will jump."""
        data, dry = self._data, self._plant.model.dof_frictionloss
        slips = np.abs(np.abs(data.qfrc_constraint) - dry) <= SLIPS * dry
        turn = TURNS / self._sampling.rate * np.abs(data.qacc)
        return bool((slips & ((dry == 0) | (np.abs(data.qvel) > turn))).all())

    def _shown(self) -> Array:
        """What sensors show, and what takes from the motors."""
        data = self._data
        lost = data.qfrc_passive + data.qfrc_constraint + data.qfrc_applied
        return np.concatenate([data.sensordata, lost])

    def _shown_amid(self, position: Array, velocity: Array, step: float) -> Array:
        """What is shown amid a step, by Hermite's cubic from its beginning to its end."""
        data = self._data
        end, end_velocity = data.qpos.copy(), data.qvel.copy()
        data.qpos[:] = (position + end) / 2 + step / 8 * (velocity - end_velocity)
        data.qvel[:] = 1.5 * (end - position) / step - (velocity + end_velocity) / 4
        mujoco.mj_forward(self._smooth_model, data)
        shown = self._shown()
        data.qpos[:], data.qvel[:] = end, end_velocity
        return shown


def _smooth_steps(model: mujoco.MjModel, sampling: Sampling) -> int:
    """Steps that a smooth sample needs, for the fastest of what damps or springs; 0 if no fewer."""
    loose = model.dof_invweight0
    spring = model.jnt_stiffness[model.dof_jntid]
    fastest = max(np.max(model.dof_damping * loose), np.sqrt(np.max(spring * loose)))
    longest = min(SMOOTH_STEP, SMOOTH_DECAY / max(fastest, 1e-9))
    steps = int(np.ceil(1 / sampling.rate / longest * (1 - 1e-9)))
    return steps if steps < sampling.steps else 0


def _gear_friction(gears: Gears, plant: Plant, data: mujoco.MjData) -> Callable[[], Array]:
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
    progress: Callable[[int, int], None] = lambda done, total: None,
    watch: Watch = lambda time, truth: None,
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
    lead, samples = round(sampling.warm_up * sampling.rate), round(duration * sampling.rate)
    times = np.arange(round(sampling.begin * sampling.rate) - lead, samples) / sampling.rate
    drive = computed_torque(tree, motion, times, bandwidth)
    loop, logs = SampledLoop(plant, drive, sampling, forces, gears), []
    for first in range(0, len(times), _SLAB):
        last = min(first + _SLAB, len(times))
        with unwarned_steps():  # a state that blows up is found below
            logs.append(vars(loop.run(range(first, last))))
        if not all(np.isfinite(values).all() for values in logs[-1].values()):
            raise SimulationDiverged(
                f"the simulation became unstable near t = {times[last - 1]:.2f} s; use a "
                "smaller step or a lower drive bandwidth"
            )
        progress(last, len(times))
        watch(times[first:last], Truth(**logs[-1]))
    truth = Truth(**{name: np.concatenate([log[name] for log in logs])[lead:] for name in logs[0]})
    return _followed(times[lead:], truth, drive, tree)


def _followed(time: Array, truth: Truth, drive: Controller, tree: Tree) -> Rollout:
    """How well a run followed its reference.

    Raises:
        SimulationDiverged: A joint was off by more than it should have moved.
    """
    wanted = drive.q[-len(time) :]
    tracking = np.sqrt(np.mean((truth.position - wanted) ** 2, axis=0))
    lost = np.array(tree.names)[tracking > np.ptp(wanted, axis=0)]
    if lost.size:
        raise SimulationDiverged(
            f"the drive lost the reference at {', '.join(lost)}; lower the motion's limits"
        )
    at_limit = np.abs(truth.torque) >= drive.effort * (1 - 1e-12)
    return Rollout(time, truth, tracking, at_limit.mean(axis=0))
