"""Free base with measured pose: six coordinates before the first body of a robot.

The base is translated along the axes of the ground, then rotated about z, y and x: yaw, pitch and
roll. The bodies between these coordinates are massless; the body after the last coordinate is the
base. The ground takes the place of the bedplate: the wrench exerted by the ground is the sum of the
wrenches of all plates.
"""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.robot.tree import JointKind

BASE_COORDINATES: tuple[tuple[str, JointKind, int], ...] = (
    ("base.x", "prismatic", 0),
    ("base.y", "prismatic", 1),
    ("base.z", "prismatic", 2),
    ("base.yaw", "revolute", 2),
    ("base.pitch", "revolute", 1),
    ("base.roll", "revolute", 0),
)
"""Names, joint kinds and axes of the base coordinates, from the ground to the base."""

N_BASE_COORDINATES = len(BASE_COORDINATES)
"""Number of base coordinates."""

MAX_PITCH = np.deg2rad(80.0)
"""Largest accepted pitch, as yaw and roll become singular at 90 degrees [rad]."""

QUATERNION_NORM_TOLERANCE = 1e-2
"""Largest deviation of a measured quaternion's length from one."""


def base_poses(q: Array) -> Array:
    """Base poses from base coordinates, inverse of `base_coordinates`, (M, 7) [m, 1].

    A pose consists of the position and the quaternion (w, x, y, z) of the base frame in the ground
    frame, for each of M samples.

    Args:
        q: Base coordinates x, y, z, yaw, pitch, roll, (M, 6) [m, rad].
    """
    from scipy.spatial.transform import Rotation

    rotations = Rotation.from_euler("ZYX", q[:, 3:])
    return np.hstack([q[:, :3], rotations.as_quat(scalar_first=True)])


def base_coordinates(base: Array) -> Array:
    """Base coordinates x, y, z, yaw, pitch, roll of measured base poses, (M, 6) [m, rad].

    Angles are unwrapped along the M samples.

    Args:
        base: Positions and quaternions (w, x, y, z) of the base frame in the ground frame, (M, 7)
            [m, 1].

    Raises:
        RecordingError: A quaternion's length differs from one by more than
            QUATERNION_NORM_TOLERANCE, or a pitch exceeds MAX_PITCH in magnitude.
    """
    from scipy.spatial.transform import Rotation

    norms = np.linalg.norm(base[:, 3:], axis=1)
    bad = np.flatnonzero(~(np.abs(norms - 1) <= QUATERNION_NORM_TOLERANCE))
    if bad.size:
        raise RecordingError(
            f"the base's quaternion has length {norms[bad[0]]:.3g} at sample {bad[0]}, one of "
            f"{bad.size} such: it is (w, x, y, z) of length one"
        )
    rotations = Rotation.from_quat(base[:, 3:], scalar_first=True)
    if np.abs(rotations.as_matrix()[:, 2, 0]).max(initial=0.0) > np.sin(MAX_PITCH):
        raise RecordingError(
            "the base's pitch goes beyond 80 degrees, where yaw and roll are no coordinates: turn "
            "the ground's frame, so that the base stands upright in it"
        )
    return np.hstack([base[:, :3], np.unwrap(rotations.as_euler("ZYX"), axis=0)])
