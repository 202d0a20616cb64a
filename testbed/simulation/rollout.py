"""Rollout the robot along a motion and log what happens, sample by sample.

What MuJoCo holds after a step is a mixture: sensors belong to the state before it, forces
to the last stage of the integrator. The first and the last instant of each sample are
therefore computed anew. Averaged samples are trapezoidal means over the sample of every
channel alike, the torque held over it; their acceleration is the gain of velocity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from mujoco.batch import Batch

from testbed.arrays import Array
from testbed.errors import TestbedError
from testbed.recordings.recording import Truth
from testbed.robot.formats.mjcf_compile import unwarned_steps
from testbed.robot.tree import Tree
from testbed.simulation.controller import Controller, Reference, computed_torque
from testbed.simulation.effect import StepForces
from testbed.simulation.plant import Plant

_STATE = ("qpos", "qvel")
_RECORD = ("sensordata", "qfrc_passive", "qfrc_constraint")
_FIRST = {"sensordata": 0, "qfrc_passive": 1, "qfrc_constraint": 1}
_SLAB = 1000
"""Samples between two reports of progress, and held in full detail at once."""


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


@dataclass(frozen=True)
class Sampling:
    """How a run is cut into samples.

    Attributes:
        rate: Samples a second, also the controller's rate [Hz].
        steps: Simulation steps a sample.
        averaged: Each sample is the mean over its steps (integrate and dump), else its
            first instant.
        warm_up: Time run before the recording starts [s].
    """

    rate: float
    steps: int
    averaged: bool
    warm_up: float


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
    begin: float = 0.0,
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
        begin: When the recording begins, 0 or earlier [s].

    Raises:
        SimulationDiverged: The robot did not follow.
    """
    lead, samples = round(sampling.warm_up * sampling.rate), round(duration * sampling.rate)
    times = np.arange(round(begin * sampling.rate) - lead, samples) / sampling.rate
    drive = computed_torque(tree, motion, times, bandwidth)
    loop = _Loop(plant, drive, sampling, forces)
    logs: list[Truth] = []
    for first in range(0, len(times), _SLAB):
        last = min(first + _SLAB, len(times))
        with unwarned_steps():  # a state that blows up is found below
            logs.append(loop.run(range(first, last)))
        if not all(np.isfinite(values).all() for values in vars(logs[-1]).values()):
            raise SimulationDiverged(
                f"the simulation became unstable near t = {times[last - 1]:.2f} s; use a smaller "
                "step or a lower drive bandwidth"
            )
        progress(last, len(times))
        watch(times[first:last], logs[-1])
    whole = {key: np.concatenate([vars(log)[key] for log in logs])[lead:] for key in vars(logs[0])}
    return _rollout_of(times[lead:], Truth(**whole), drive, tree)


def _rollout_of(time: Array, truth: Truth, drive: Controller, tree: Tree) -> Rollout:
    wanted = drive.reference.q[-len(time) :]
    tracking = np.sqrt(np.mean((truth.position - wanted) ** 2, axis=0))
    swing = np.ptp(wanted, axis=0)
    lost = [name for name, e, s in zip(tree.names, tracking, swing, strict=True) if e > s]
    if lost:
        raise SimulationDiverged(
            f"the drive lost the reference at {', '.join(lost)}; lower the motion's limits"
        )
    at_limit = np.abs(truth.torque) >= drive.effort * (1 - 1e-12)
    return Rollout(time, truth, tracking, at_limit.mean(axis=0))


class _Loop:
    """MuJoCo's state, the controller around it, and the log of it."""

    def __init__(
        self, plant: Plant, drive: Controller, sampling: Sampling, forces: StepForces | None
    ) -> None:
        self._plant, self._drive, self._sampling, self._forces = plant, drive, sampling, forces
        self._batch = Batch(plant.model, nsim=1, nthread=1)
        keys = (*_STATE, *_RECORD, "qacc", "ctrl", "qfrc_applied")
        self._live = {key: self._batch.bind(key)[0] for key in keys}
        self._live["qpos"][:] = plant.dofs @ drive.reference.q[0]  # every joint has one position
        self._changing = False
        self._live["qvel"][:] = plant.dofs @ drive.reference.qd[0]

    def run(self, samples: range) -> Truth:
        """Follow some samples of the reference."""
        order, steps = self._plant.order, self._sampling.steps
        torque, applied = np.empty((2, len(samples), len(order)))
        slab = {key: np.empty((len(samples), steps + 1, len(self._live[key]))) for key in _RECORD}
        start, end = np.empty((2, len(samples), len(order)))
        for row, k in enumerate(samples):
            position, velocity = (self._live[key][order] for key in _STATE)
            torque[row] = self._drive.torque(k, position, velocity)
            self._live["ctrl"][:] = torque[row]
            applied[row] = self._push(k, 0)
            self._batch.forward()  # the first instant, under the new torque
            self._note(slab, row, 0)
            start[row] = self._live["qacc"][order]
            if self._sampling.averaged:
                start[row] = velocity
                # sensors are of each step's first instant, forces of its last
                out = {key: slab[key][row : row + 1, _FIRST[key] :][:, :steps] for key in _RECORD}
                applied[row] += self._steps(k, out)
                self._batch.forward()  # the last instant, still under the old torque
                self._note(slab, row, steps)
                end[row] = self._live["qvel"][order]
                applied[row] /= steps
            else:
                self._steps(k, {})
        acceleration = (end - start) * self._sampling.rate if self._sampling.averaged else start
        log = {key: self._sampled(slab[key]) for key in _RECORD}
        return self._truth(log, torque, applied, acceleration)

    def _steps(self, k: int, out: dict[str, Array]) -> Array:
        """The steps of sample k, recorded; the sum of the forces pushed after the first one."""
        steps, total = self._sampling.steps, np.zeros(len(self._plant.order))
        if self._forces is None:
            self._batch.rollout(steps, record=tuple(out) or ("qpos",), out=out or None)
            return total
        for step in range(steps):
            before = None
            if step:
                before = self._sensed_before_push(out)
                total += self._push(k, step)
            here = {key: values[:, step : step + 1] for key, values in out.items()}
            self._batch.rollout(1, record=tuple(out) or ("qpos",), out=here or None)
            if before is not None and self._changing:
                here["sensordata"][:] = (here["sensordata"] + before) / 2
        return total

    def _sensed_before_push(self, out: dict[str, Array]) -> Array | None:
        """What the sensors show at the end of a step: pushes jump from step to step."""
        if not out or not self._changing:
            return None
        self._batch.forward()
        return np.array(self._live["sensordata"])

    def _push(self, k: int, step: int) -> Array:
        """Apply the forces of a step of sample k, which belong to the state before it."""
        order = self._plant.order
        if self._forces is None:
            return np.zeros(len(order))
        time = self._drive.reference.t[k] + step / (self._sampling.steps * self._sampling.rate)
        position, velocity = (self._live[key][order] for key in _STATE)
        force = self._forces(time, position, velocity, self._live["ctrl"].copy())
        self._changing = bool((force != self._live["qfrc_applied"][order]).any())
        self._live["qfrc_applied"][order] = force
        return force

    def _note(self, slab: dict[str, Array], row: int, instant: int) -> None:
        for key in _RECORD:
            slab[key][row, instant] = self._live[key]

    def _sampled(self, slab: Array) -> Array:
        """The mean over each sample by the trapezoidal rule, or its first instant."""
        if not self._sampling.averaged:
            return slab[:, 0]
        inner = slab[:, 1:-1].sum(axis=1)
        mean: Array = (inner + (slab[:, 0] + slab[:, -1]) / 2) / self._sampling.steps
        return mean

    def _truth(
        self, log: dict[str, Array], torque: Array, applied: Array, acceleration: Array
    ) -> Truth:
        sensed = log["sensordata"]
        lost = log["qfrc_passive"] + log["qfrc_constraint"]
        return Truth(
            position=sensed[:, self._plant.positions],
            velocity=sensed[:, self._plant.velocities],
            acceleration=acceleration,
            torque=torque,
            friction=-lost @ self._plant.dofs - applied,
            wrench=self._plant.bedplate_wrench(sensed[:, self._plant.plate]),
        )
