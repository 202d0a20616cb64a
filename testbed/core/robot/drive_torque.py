"""Friction and rotor-inertia torques of the joints, from the coefficients of the model file."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.robot.friction import JOINT_LAWS
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.tree import Tree


def friction_torque(tree: Tree, qd: Array, smooth: float = 0.0) -> Array:
    """Torque that overcomes joint friction, with the sign of the velocity, (..., n) [N m or N].

    The torque is the sum of Coulomb and viscous friction.

    Args:
        tree: Robot with the friction coefficients.
        qd: Joint velocities, (..., n) [rad/s or m/s].
        smooth: Speed v0 of the smooth function tanh(qd / v0) that replaces sign(qd) in Coulomb
            friction [rad/s or m/s]; 0 for sign(qd) itself.
    """
    return _sum_of_laws(
        tree,
        (law for law in JOINT_LAWS if law.dissipative),
        qd,
        np.zeros_like(qd),
        smooth,
    )


def drive_torque(tree: Tree, qd: Array, qdd: Array, smooth: float = 0.0) -> Array:
    """Torque that overcomes joint friction and accelerates the rotors, (..., n) [N m or N].

    Args:
        tree: Robot with the friction coefficients and rotor inertias.
        qd: Joint velocities, (..., n) [rad/s or m/s].
        qdd: Joint accelerations, (..., n) [rad/s^2 or m/s^2].
        smooth: Speed v0 of the smooth function tanh(qd / v0) that replaces sign(qd) in Coulomb
            friction [rad/s or m/s]; 0 for sign(qd) itself.
    """
    return _sum_of_laws(
        tree, (law for law in JOINT_LAWS if law.parameter is not None), qd, qdd, smooth
    )


def _sum_of_laws(
    tree: Tree, laws: Iterable[JointLaw], qd: Array, qdd: Array, smooth: float
) -> Array:
    """Sum of coefficient times regressor column over joint laws, (..., n) [N m or N]."""
    torques = [law.coefficients(tree) * law.columns(qd, qdd, smooth) for law in laws]
    return np.asarray(np.sum(torques, axis=0))
