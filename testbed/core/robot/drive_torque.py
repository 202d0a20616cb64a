"""Friction and rotor torques of the drives, by the coefficients of the model file."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.robot.friction import LAWS
from testbed.core.robot.tree import Tree


def friction_torque(tree: Tree, qd: Array, smooth: float = 0.0) -> Array:
    """Torque that overcomes joint friction, with the sign of the velocity, (..., n) [N m or N].

    Args:
        tree: Gives the coefficients.
        qd: Velocities, (..., n) [rad/s or m/s].
        smooth: Speed over which the sign of dry friction is smoothed [rad/s or m/s].
    """
    laws = [law for law in LAWS if law.resists]
    still = np.zeros_like(qd)
    return _sum([law.coefficients(tree) * law.columns(qd, still, smooth) for law in laws])


def drive_torque(tree: Tree, qd: Array, qdd: Array, smooth: float = 0.0) -> Array:
    """Torque that overcomes joint friction and accelerates rotors, (..., n) [N m or N].

    Args:
        tree: Gives the coefficients: friction, and the rotors' inertias.
        qd: Velocities, (..., n) [rad/s or m/s].
        qdd: Accelerations, (..., n) [rad/s^2 or m/s^2].
        smooth: Speed over which the sign of dry friction is smoothed [rad/s or m/s].
    """
    laws = [law for law in LAWS if law.parameter is not None]
    return _sum([law.coefficients(tree) * law.columns(qd, qdd, smooth) for law in laws])


def _sum(torques: list[Array]) -> Array:
    total: Array = sum(torques[1:], torques[0])
    return total
