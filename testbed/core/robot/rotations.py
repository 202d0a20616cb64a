"""Conversions between roll-pitch-yaw angles of URDF, rotation vectors, matrices and quaternions."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array
from testbed.core.base.transform import Transform


def rpy_to_matrix(rpy: ArrayLike) -> Array:
    """Rotation matrix of roll, pitch and yaw about fixed axes x, y, z, (3, 3).

    Args:
        rpy: Angles of the rotations about x, then y, then z, (3,) [rad].
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", rpy).as_matrix())


def matrix_to_rpy(R: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation matrix about fixed axes x, y, z [rad].

    In gimbal lock (pitch of +-90 degrees), roll is set to zero and yaw takes the remaining
    rotation.

    Args:
        R: Rotation matrix, (3, 3).
    """
    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings(action="ignore"):  # warning of gimbal lock
        yaw, pitch, roll = Rotation.from_matrix(R).as_euler("ZYX").tolist()
    return roll, pitch, yaw


def rotvec_to_matrix(vector: ArrayLike) -> Array:
    """Rotation matrix of a rotation vector, (3, 3).

    Args:
        vector: Rotation axis times angle, (3,) [rad].
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(np.array(vector)).as_matrix())


def matrix_to_quaternion(R: Array) -> Array:
    """Quaternions (w, x, y, z) of rotation matrices, (..., 4).

    Args:
        R: Rotation matrices, (..., 3, 3).
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(R).as_quat(scalar_first=True))


def joint_displacement(axis: Array, q: float, *, revolute: bool) -> Transform:
    """Pose of a body at joint position q, relative to the pose at q = 0.

    Args:
        axis: Unit vector of the joint axis, (3,).
        q: Joint position [rad or m].
        revolute: True for a revolute joint, False for a prismatic joint.
    """
    if not q:
        return Transform()
    return (
        Transform(rotvec_to_matrix(q * axis))
        if revolute
        else Transform(p_AB_A=q * axis)
    )
