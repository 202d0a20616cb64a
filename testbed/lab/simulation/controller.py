"""The robot's own controller: computed torque along a sampled reference."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion, joint_forces
from testbed.core.robot.drive_torque import drive_torque
from testbed.core.robot.friction import ROTOR
from testbed.core.robot.tree import Tree

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


class Controller(NamedTuple):
    """A controller along a sampled reference, as machine code takes it.

    Attributes:
        times: Of the samples, (T,) [s].
        q: Positions to follow, (T, n) [rad or m].
        qd: Velocities, (T, n) [rad/s or m/s].
        expected: Torque expected along them, (T, n) [N m or N].
        inertia: Mass matrices of the a-priori model, (grid, n, n).
        posture: Which of them applies to each sample, (T,).
        bandwidth: Of the position loop [rad/s].
        effort: Limits of the motors, (n,) [N m or N].
    """

    times: Array
    q: Array
    qd: Array
    expected: Array
    inertia: Array
    posture: NDArray[np.int64]
    bandwidth: float
    effort: Array


def computed_torque(
    tree: Tree, motion: Reference, times: Array, bandwidth: float
) -> Controller:
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
        times=times,
        q=reference.q,
        qd=reference.qd,
        expected=joint_forces(tree, reference) + besides,
        inertia=mass_matrices(tree, grid) + np.diag(ROTOR.coefficients(tree)),
        posture=np.floor((phase - np.floor(phase)) * _PERIOD_GRID).astype(int)
        % _PERIOD_GRID,
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
    motion = Motion(
        np.arange(k * n, dtype=float), postures.repeat(n, axis=0), still, pushes
    )
    return joint_forces(tree, motion, gravity=np.zeros(3)).reshape(k, n, n)
