"""Roll out a robot along its motion and log what happens, sample by sample.

What MuJoCo holds after a step is a mixture: sensors belong to the state before it, forces
to the last stage of the integrator. Every instant that counts is therefore computed anew, under
the torque and the forces of its own step. Averaged samples are means over the sample of every
channel alike, the torque held over it; their acceleration is the gain of velocity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from testbed.arrays import Array
from testbed.errors import TestbedError
from testbed.recordings.recording import Truth
from testbed.robot.formats.mjcf_compile import unwarned_steps
from testbed.robot.tree import Tree
from testbed.simulation.controller import Controller, Reference, computed_torque
from testbed.simulation.effect import StepForces
from testbed.simulation.plant import Plant
from testbed.simulation.sampled_loop import SampledLoop, Sampling

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

    Raises:
        SimulationDiverged: The robot did not follow.
    """
    lead, samples = round(sampling.warm_up * sampling.rate), round(duration * sampling.rate)
    times = np.arange(round(sampling.begin * sampling.rate) - lead, samples) / sampling.rate
    drive = computed_torque(tree, motion, times, bandwidth)
    loop, logs = SampledLoop(plant, drive, sampling, forces), []
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


def _rollout_of(time: Array, logs: Sequence[Truth], drive: Controller, tree: Tree) -> Rollout:
    count = len(time)
    whole = {k: np.concatenate([vars(log)[k] for log in logs])[-count:] for k in vars(logs[0])}
    truth, wanted = Truth(**whole), drive.q[-count:]
    tracking = np.sqrt(np.mean((truth.position - wanted) ** 2, axis=0))
    swing = np.ptp(wanted, axis=0)
    lost = [name for name, e, s in zip(tree.names, tracking, swing, strict=True) if e > s]
    if lost:
        raise SimulationDiverged(
            f"the drive lost the reference at {', '.join(lost)}; lower the motion's limits"
        )
    at_limit = np.abs(truth.torque) >= drive.effort * (1 - 1e-12)
    return Rollout(time, truth, tracking, at_limit.mean(axis=0))
