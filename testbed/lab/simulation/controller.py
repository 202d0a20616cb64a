"""Simulated robot controller: computed torque along a sampled reference motion."""

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

_PERIOD_GRID = 500  # postures per period at which M is computed
_SMOOTHING_SPEED = (
    0.05  # speed over which expected dry friction is smoothed [rad/s or m/s]
)


class ReferenceMotion(Protocol):
    """Reference motion of the joint controller: a closed path as a function of time."""

    @property
    def period(self) -> float:
        """Duration of one pass of the closed path at nominal speed [s]."""

    def at(self, t: Array) -> Motion:
        """Motion at times t, (M,) [s]; times 0 to one period cover the whole path."""

    def path_time(self, t: Array) -> Array:
        """Path parameter at times t: the corresponding time at nominal speed, (M,) [s]."""


class Controller(NamedTuple):
    """Sampled computed-torque controller, stored as arrays for compiled code.

    Attributes:
        times: Times of the samples, (T,) [s].
        q: Reference positions, (T, n) [rad or m].
        qd: Reference velocities, (T, n) [rad/s or m/s].
        feedforward: Feedforward torque of the reference, (T, n) [N m or N].
        inertia: Mass matrices of the a-priori model on a grid of postures, (grid, n, n).
        mass_matrix_index: Index of the mass matrix to use at each sample, (T,).
        bandwidth: Bandwidth of the position loop [rad/s].
        effort: Torque limits of the motors, (n,) [N m or N].
    """

    times: Array
    q: Array
    qd: Array
    feedforward: Array
    inertia: Array
    mass_matrix_index: NDArray[np.int64]
    bandwidth: float
    effort: Array


def computed_torque(
    tree: Tree, motion: ReferenceMotion, times: Array, bandwidth: float
) -> Controller:
    """Computed-torque controller for a reference motion along a closed path.

    The feedforward is the inverse dynamics plus friction and rotor torques, with dry friction
    smoothed over 0.05 rad/s. Mass matrices, including rotors, are computed at 500 postures along
    the path.

    Args:
        tree: A-priori model of the robot and its friction, used by the controller.
        motion: Reference motion.
        times: Times of the samples, (T,) [s].
        bandwidth: Bandwidth of the position loop [rad/s].
    """
    reference = motion.at(times)
    grid = motion.at(np.linspace(0, motion.period, _PERIOD_GRID, endpoint=False)).q
    phase = motion.path_time(times) / motion.period
    drive_torques = drive_torque(tree, reference.qd, reference.qdd, _SMOOTHING_SPEED)
    return Controller(
        times=times,
        q=reference.q,
        qd=reference.qd,
        feedforward=joint_forces(tree, reference) + drive_torques,
        inertia=mass_matrices(tree, grid) + np.diag(ROTOR.coefficients(tree)),
        mass_matrix_index=np.floor((phase - np.floor(phase)) * _PERIOD_GRID).astype(int)
        % _PERIOD_GRID,
        bandwidth=bandwidth,
        effort=np.array([joint.max_effort for joint in tree.joints]),
    )


def mass_matrices(tree: Tree, postures: Array) -> Array:
    """Mass matrix M(q) at each posture without rotors, (k, n, n) [kg m^2, kg m, kg].

    Args:
        tree: The robot.
        postures: Joint positions, (k, n) [rad or m].
    """
    k, n = postures.shape
    unit_accelerations = np.tile(
        np.eye(n), (k, 1)
    )  # one joint at a time, in each posture
    zero_velocities = np.zeros((k * n, n))
    motion = Motion(
        np.arange(k * n, dtype=float),
        postures.repeat(n, axis=0),
        zero_velocities,
        unit_accelerations,
    )
    return joint_forces(tree, motion, gravity=np.zeros(3)).reshape(k, n, n)
