"""Rotation matrices of roll, pitch and yaw as URDF has them, of rotation vectors; quaternions."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array
from testbed.core.base.transform import Transform


def from_rpy(rpy: ArrayLike) -> Array:
    """Rotation about the fixed axes x, y, z in this order by three angles [rad], (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", rpy).as_matrix())


def to_rpy(R: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation matrix [rad].

    Where the pitch is a right angle, and only roll and yaw together count, the roll is zero.
    """
    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings(action="ignore"):  # of gimbal lock
        yaw, pitch, roll = Rotation.from_matrix(R).as_euler("ZYX").tolist()
    return roll, pitch, yaw


def from_vector(vector: ArrayLike) -> Array:
    """Rotation matrix of a rotation vector, (3,) [rad]."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(np.array(vector)).as_matrix())


def to_quaternion(R: Array) -> Array:
    """Quaternions (w, x, y, z) of rotation matrices, (..., 3, 3), (..., 4)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(R).as_quat(scalar_first=True))


def displacement(axis: Array, q: float, *, revolute: bool) -> Transform:
    """Pose of a body displaced by its joint in the joint's frame.

    Args:
        axis: Unit vector, (3,).
        q: Position [rad or m].
        revolute: Whether the joint turns (else it slides).
    """
    if not q:
        return Transform()
    return Transform(from_vector(q * axis)) if revolute else Transform(p_AB_A=q * axis)
