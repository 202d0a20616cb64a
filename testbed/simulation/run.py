"""Run the robot along a motion and log what happens, sample by sample.

Derived quantities of a MuJoCo step belong to the state before it; positions and
velocities are therefore logged as sensors, never as the state after the step. Averaged
samples are the mean over the sample's steps of every channel alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mujoco.batch import Batch

from testbed.arrays import Array
from testbed.dynamics.dynamics import joint_forces
from testbed.errors import TestbedError
from testbed.excitation.fourier import Fourier
from testbed.measurement.recording import Truth
from testbed.simulation.drive import Drive
from testbed.simulation.scene import Scene
from testbed.tree.tree import Tree

_RECORD = ("sensordata", "qacc", "qfrc_passive", "qfrc_constraint", "qfrc_actuator")
_SLAB = 1000
"""Samples between two reports of progress, and held in full detail at once."""


class Diverged(TestbedError):
    """The simulation left the reference or became unstable."""


@dataclass(frozen=True, eq=False)
class Run:
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
    scene: Scene,
    tree: Tree,
    motion: Fourier,
    duration: float,
    drive: Drive,
    sampling: Sampling,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Run:
    """Follow a periodic motion in closed loop.

    Args:
        scene: The robot on its bedplate.
        tree: The drive's own model of the robot.
        motion: The reference.
        duration: Of the recording [s].
        drive: The controller.
        sampling: How the run is cut into samples.
        progress: Called with samples done and samples in all.

    Raises:
        Diverged: The robot did not follow.
    """
    lead, samples = round(sampling.warm_up * sampling.rate), round(duration * sampling.rate)
    times = np.arange(-lead, samples) / sampling.rate
    reference = motion.at(times)
    modelled = joint_forces(tree, reference)
    loop = _Loop(scene, drive, sampling, reference.q[0], reference.qd[0])
    logs: list[dict[str, Array]] = []
    for first in range(0, len(times), _SLAB):
        part = slice(first, min(first + _SLAB, len(times)))
        logs.append(loop.run(reference.q[part], reference.qd[part], modelled[part]))
        if not all(np.isfinite(values).all() for values in logs[-1].values()):
            raise Diverged(
                f"the simulation became unstable near t = {times[part.stop - 1]:.2f} s; use a "
                "smaller step or a lower drive bandwidth"
            )
        progress(part.stop, len(times))
    log = {key: np.concatenate([each[key] for each in logs])[lead:] for key in logs[0]}
    truth = _truth(scene, log)
    error = truth.position - reference.q[lead:]
    at_limit = np.abs(truth.torque) >= drive.effort * (1 - 1e-12)
    run = Run(
        time=times[lead:],
        truth=truth,
        tracking=np.sqrt(np.mean(error**2, axis=0)),
        saturated=at_limit.mean(axis=0),
    )
    swing = np.ptp(reference.q, axis=0)
    lost = [name for name, e, s in zip(tree.names, run.tracking, swing, strict=True) if e > s]
    if lost:
        raise Diverged(
            f"the drive lost the reference at {', '.join(lost)}; lower the motion's limits"
        )
    return run


class _Loop:
    """MuJoCo's state and the controller around it."""

    def __init__(self, scene: Scene, drive: Drive, sampling: Sampling, q: Array, qd: Array) -> None:
        self._scene, self._drive, self._sampling = scene, drive, sampling
        self._batch = Batch(scene.model, nsim=1, nthread=1)
        self._position, self._velocity = (self._batch.bind(key)[0] for key in ("qpos", "qvel"))
        self._position[scene.order], self._velocity[scene.order] = q, qd  # one each per joint

    def run(self, q: Array, qd: Array, modelled: Array) -> dict[str, Array]:
        """Some samples of the reference; the log of each field, (samples, size)."""
        steps, order = self._sampling.steps, self._scene.order
        slab = {key: np.empty((len(q), steps, self._size(key))) for key in _RECORD}
        control = np.empty((1, steps, len(order)))
        for k in range(len(q)):
            late, slow = q[k] - self._position[order], qd[k] - self._velocity[order]
            control[:] = self._drive.torque(modelled[k], late, slow)
            out = {key: values[k : k + 1] for key, values in slab.items()}
            self._batch.rollout(steps, control, record=_RECORD, out=out)
        if self._sampling.averaged:
            return {key: values.mean(axis=1) for key, values in slab.items()}
        return {key: values[:, 0] for key, values in slab.items()}

    def _size(self, key: str) -> int:
        model = self._scene.model
        return int(model.nsensordata if key == "sensordata" else model.nv)


def _truth(scene: Scene, log: dict[str, Array]) -> Truth:
    sensed, order = log["sensordata"], scene.order
    return Truth(
        position=sensed[:, scene.positions],
        velocity=sensed[:, scene.velocities],
        acceleration=log["qacc"][:, order],
        torque=log["qfrc_actuator"][:, order],
        friction=-(log["qfrc_passive"] + log["qfrc_constraint"])[:, order],
        wrench=scene.bedplate_wrench(sensed[:, scene.plate]),
    )
