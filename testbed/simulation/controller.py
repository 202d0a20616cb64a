"""The robot's own controller: computed torque, as a well-tuned drive would deliver it.

Torque = model along the reference + friction expected there + M(q_ref) times a
proportional and derivative action. M decouples the joints, so that one bandwidth serves
heavy and light ones alike; it is taken from the a-priori model once for a period.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import joint_forces
from testbed.dynamics.motion import Motion
from testbed.robot.friction import ROTOR, drive_torque
from testbed.robot.tree import Tree

DAMPING = 0.9
"""Damping ratio of the position loop."""

_PERIOD_GRID = 500  # postures of a period at which M is known
_SMOOTH = 0.05  # speed below which the expected dry friction fades out [rad/s or m/s]


class Reference(Protocol):
    """What a drive follows: a path that closes, run through in some time."""

    @property
    def period(self) -> float:
        """In which the path closes, where it is run through as it is [s]."""

    def at(self, t: Array) -> Motion:
        """The motion at times t, (M,) [s]; from 0 to one period, along all of the path."""

    def place(self, t: Array) -> Array:
        """Where on the path at times t, (M,), as a time of it [s]."""


@dataclass(frozen=True, eq=False)
class Controller:
    """A controller along a sampled reference.

    Attributes:
        reference: The motion to follow, T samples.
        expected: Torque expected along it, (T, n) [N m or N].
        inertia: Mass matrices of the a-priori model, (grid, n, n).
        posture: Which of them applies to each sample, (T,).
        bandwidth: Of the position loop [rad/s].
        effort: Limits of the motors, (n,) [N m or N].
    """

    reference: Motion
    expected: Array
    inertia: Array
    posture: Array
    bandwidth: float
    effort: Array

    def torque(self, k: int, position: Array, velocity: Array) -> Array:
        """Motor torques for sample k, (n,) [N m or N], within the limits of the motors."""
        late, slow = self.reference.q[k] - position, self.reference.qd[k] - velocity
        action = self.bandwidth**2 * late + 2 * DAMPING * self.bandwidth * slow
        return _limited(self.expected[k], self.inertia[self.posture[k]], action, self.effort)


class Controllers:
    """Controllers of robots that are simulated together, one time after the other.

    What one of them asks for does not depend on the others, to the bit: there are no sums over
    several of them, and none whose order a library chooses.
    """

    def __init__(self, controllers: Sequence[Controller]) -> None:
        """Put side by side.

        Args:
            controllers: R of them, all of n joints and T samples.
        """
        every = list(controllers)
        self._q = np.stack([each.reference.q for each in every], axis=1)  # (T, R, n)
        self._qd = np.stack([each.reference.qd for each in every], axis=1)
        self._expected = np.stack([each.expected for each in every], axis=1)
        self._inertia = np.stack([each.inertia for each in every])  # (R, grid, n, n)
        self._posture = np.stack([each.posture for each in every], axis=1)  # (T, R)
        bandwidth = np.array([[each.bandwidth] for each in every])
        self._stiff, self._damped = bandwidth**2, 2 * DAMPING * bandwidth
        self._effort = np.stack([each.effort for each in every])
        self._which = np.arange(len(every))

    def torque(self, k: int, position: Array, velocity: Array) -> Array:
        """Motor torques of all for sample k, (R, n) [N m or N].

        Args:
            k: The sample.
            position: (R, n) [rad or m].
            velocity: (R, n) [rad/s or m/s].
        """
        action = self._stiff * (self._q[k] - position) + self._damped * (self._qd[k] - velocity)
        inertia = self._inertia[self._which, self._posture[k]]
        return _limited(self._expected[k], inertia, action, self._effort)


def _limited(expected: Array, inertia: Array, action: Array, effort: Array) -> Array:
    """Expected torque and inertia times action, (..., n), within the limits of the motors."""
    wanted = expected
    for j in range(action.shape[-1]):
        wanted = wanted + inertia[..., j] * action[..., j : j + 1]
    limited: Array = np.minimum(np.maximum(wanted, -effort), effort)
    return limited


def computed_torque(tree: Tree, motion: Reference, times: Array, bandwidth: float) -> Controller:
    """A drive that follows a motion along a path that closes.

    Args:
        tree: The drive's own model of the robot and its friction.
        motion: What to follow.
        times: Of the samples, (T,) [s].
        bandwidth: Of the position loop [rad/s].
    """
    reference = motion.at(times)
    grid = motion.at(np.linspace(0, motion.period, _PERIOD_GRID, endpoint=False)).q
    phase = motion.place(times) / motion.period
    besides = drive_torque(tree, reference.qd, reference.qdd, _SMOOTH)
    return Controller(
        reference=reference,
        expected=joint_forces(tree, reference) + besides,
        inertia=mass_matrices(tree, grid) + np.diag(ROTOR.coefficients(tree)),
        posture=np.floor((phase - np.floor(phase)) * _PERIOD_GRID).astype(int) % _PERIOD_GRID,
        bandwidth=bandwidth,
        effort=np.array([joint.max_effort for joint in tree.joints]),
    )


def mass_matrices(tree: Tree, postures: Array) -> Array:
    """M(q) of every posture, (k, n, n) [kg m^2, kg m, kg], without rotors.

    Args:
        tree: The robot.
        postures: (k, n) [rad or m].
    """
    k, n = postures.shape
    pushes = np.tile(np.eye(n), (k, 1))  # each joint alone, in every posture
    still = np.zeros((k * n, n))
    motion = Motion(np.arange(k * n, dtype=float), postures.repeat(n, axis=0), still, pushes)
    return joint_forces(tree, motion, gravity=np.zeros(3)).reshape(k, n, n)
