"""Friction and rotor torques of the drives, by the coefficients of the model file."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.robot.friction import LAWS
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.tree import Tree


def friction_torque(tree: Tree, qd: Array, smooth: float = 0.0) -> Array:
    """Torque that overcomes joint friction, with the sign of the velocity, (..., n) [N m or N].

    Args:
        tree: Gives the coefficients.
        qd: Velocities, (..., n) [rad/s or m/s].
        smooth: Speed over which the sign of dry friction is smoothed [rad/s or m/s].
    """
    return _torque(
        tree, (law for law in LAWS if law.resists), qd, np.zeros_like(qd), smooth
    )


def drive_torque(tree: Tree, qd: Array, qdd: Array, smooth: float = 0.0) -> Array:
    """Torque that overcomes joint friction and accelerates rotors, (..., n) [N m or N].

    Args:
        tree: Gives the coefficients: friction, and the rotors' inertias.
        qd: Velocities, (..., n) [rad/s or m/s].
        qdd: Accelerations, (..., n) [rad/s^2 or m/s^2].
        smooth: Speed over which the sign of dry friction is smoothed [rad/s or m/s].
    """
    return _torque(
        tree, (law for law in LAWS if law.parameter is not None), qd, qdd, smooth
    )


def _torque(
    tree: Tree, laws: Iterable[JointLaw], qd: Array, qdd: Array, smooth: float
) -> Array:
    torques = [law.coefficients(tree) * law.columns(qd, qdd, smooth) for law in laws]
    return np.asarray(np.sum(torques, axis=0))
