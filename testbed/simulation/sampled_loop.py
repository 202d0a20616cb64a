"""MuJoCo's states, the controllers around them, and the log of it: the loop over samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mujoco.batch import Batch

from testbed.arrays import Array
from testbed.recordings.recording import Truth
from testbed.simulation.controller import Controller, Controllers
from testbed.simulation.effect import StepForces
from testbed.simulation.plant import Plant

_STATE = ("qpos", "qvel")
_RECORD = ("sensordata", "qfrc_passive", "qfrc_constraint")
_FIRST = {"sensordata": 0, "qfrc_passive": 1, "qfrc_constraint": 1}


@dataclass(frozen=True)
class Sampling:
    """How a run is cut into samples.

    Attributes:
        rate: Samples a second, also the controller's rate [Hz].
        steps: Simulation steps a sample.
        averaged: Each sample is the mean over its steps (integrate and dump), else its
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
    """Runs of one model, side by side."""

    def __init__(
        self,
        plants: Sequence[Plant],
        drives: Sequence[Controller],
        sampling: Sampling,
        forces: StepForces | None = None,
    ) -> None:
        """At the beginning of their references.

        Args:
            plants: R of them, of one layout.
            drives: Theirs.
            sampling: How the runs are cut into samples.
            forces: Asked before every step of a run that is alone.

        Raises:
            ValueError: Forces push one of several runs.
        """
        if forces is not None and len(plants) > 1:
            raise ValueError("forces need a simulation of their own")
        self._plants, self._drive, self._sampling = plants, Controllers(drives), sampling
        self._time, self._forces = drives[0].reference.t, forces
        self._batch = Batch(plants[0].model, nsim=len(plants), nthread=1)
        if any(plant.model is not plants[0].model for plant in plants):
            self._batch.set_models([plant.model for plant in plants])
        keys = (*_STATE, *_RECORD, "qacc", "ctrl", "qfrc_applied")
        self._live = {key: self._batch.bind(key) for key in keys}
        self._joints = _as_slice(plants[0].order)
        self._changing = False
        for row, (plant, drive) in enumerate(zip(plants, drives, strict=True)):
            # every joint has one position
            self._live["qpos"][row] = plant.dofs @ drive.reference.q[0]
            self._live["qvel"][row] = plant.dofs @ drive.reference.qd[0]

    def lay_aside(self, run: int) -> None:
        """Forget the state of a run that blew up: it goes on from zero, and does not count.

        Args:
            run: Its number.
        """
        self._live["qpos"][run] = self._live["qvel"][run] = 0.0

    def run(self, samples: range) -> list[Truth]:
        """Follow some samples of the references.

        Args:
            samples: Their numbers.
        """
        runs, count, steps = len(self._plants), len(samples), self._sampling.steps
        joints, averaged = self._joints, self._sampling.averaged
        shape = (count, runs, len(self._plants[0].order))
        torque, applied, start, end = np.zeros((4, *shape))
        slab = {
            key: np.empty((count, runs, steps + 1, self._live[key].shape[1])) for key in _RECORD
        }
        recorded = _RECORD if steps > 1 and averaged else ()  # else both ends are all there is
        out = {key: np.empty((runs, steps, self._live[key].shape[1])) for key in recorded}
        for row, k in enumerate(samples):
            position, velocity = (self._live[key][:, joints] for key in _STATE)
            torque[row] = self._drive.torque(k, position, velocity)
            self._live["ctrl"][:] = torque[row]
            if self._forces is not None:
                applied[row] = self._push(k, 0)
            self._batch.forward()  # the first instant, under the new torque
            self._note(slab, row, 0)
            start[row] = velocity if averaged else self._live["qacc"][:, joints]
            pushed = self._steps(k, out)
            if averaged:
                # sensors are of each step's first instant, forces of its last
                for key, values in out.items():
                    slab[key][row, :, _FIRST[key] : _FIRST[key] + steps] = values
                self._batch.forward()  # the last instant, still under the old torque
                self._note(slab, row, steps)
                end[row] = self._live["qvel"][:, joints]
                applied[row] = (applied[row] + pushed) / steps
        acceleration = (end - start) * self._sampling.rate if averaged else start
        log = {key: self._sampled(slab[key]) for key in _RECORD}
        return [
            self._truth(run, log, torque[:, run], applied[:, run], acceleration[:, run])
            for run in range(runs)
        ]

    def _steps(self, k: int, out: dict[str, Array]) -> Array | float:
        """The steps of sample k, recorded; the sum of the forces pushed after the first one."""
        steps = self._sampling.steps
        if self._forces is None:
            self._batch.rollout(steps, record=tuple(out) or ("qpos",), out=out or None)
            return 0.0
        total: Array = np.zeros(len(self._plants[0].order))
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
        return np.array(self._live["sensordata"][0])

    def _push(self, k: int, step: int) -> Array:
        """Apply the forces of a step of sample k, which belong to the state before it."""
        assert self._forces is not None
        joints = self._joints
        time = self._time[k] + step / (self._sampling.steps * self._sampling.rate)
        position, velocity = (self._live[key][0, joints] for key in _STATE)
        force = self._forces(time, position.copy(), velocity.copy(), self._live["ctrl"][0].copy())
        self._changing = bool((force != self._live["qfrc_applied"][0, joints]).any())
        self._live["qfrc_applied"][0, joints] = force
        return force

    def _note(self, slab: dict[str, Array], row: int, instant: int) -> None:
        for key in _RECORD:
            slab[key][row, :, instant] = self._live[key]

    def _sampled(self, slab: Array) -> Array:
        """The mean over each sample by the trapezoidal rule, or its first instant, (M, R, ...)."""
        if not self._sampling.averaged:
            return slab[:, :, 0]
        total = (slab[:, :, 0] + slab[:, :, -1]) / 2
        for step in range(1, self._sampling.steps):
            total = total + slab[:, :, step]
        mean: Array = total / self._sampling.steps
        return mean

    def _truth(
        self, run: int, log: dict[str, Array], torque: Array, applied: Array, acceleration: Array
    ) -> Truth:
        sensed, plant = np.ascontiguousarray(log["sensordata"][:, run]), self._plants[run]
        lost = np.ascontiguousarray((log["qfrc_passive"] + log["qfrc_constraint"])[:, run])
        return Truth(
            position=sensed[:, plant.positions],
            velocity=sensed[:, plant.velocities],
            acceleration=np.ascontiguousarray(acceleration),
            torque=np.ascontiguousarray(torque),
            friction=-lost @ plant.dofs - applied,
            wrench=plant.bedplate_wrench(sensed[:, plant.plate]),
        )


def _as_slice(order: Array) -> slice | Array:
    """An index that gives views where it can."""
    same = np.array_equal(order, np.arange(len(order)))
    return slice(0, len(order)) if same else order
