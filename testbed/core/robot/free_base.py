"""A robot on a base that moves and whose pose is measured: six coordinates before its first body.

The base slides along the axes of the ground and then turns about z, y and x, yaw, pitch and roll.
What carries these coordinates one by one has no matter; the body after the last one is the base.
The ground takes the bedplate's place: what it exerts is the sum of all plates.
"""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.robot.tree import Kind

COORDINATES: tuple[tuple[str, Kind, int], ...] = (
    ("base.x", "prismatic", 0),
    ("base.y", "prismatic", 1),
    ("base.z", "prismatic", 2),
    ("base.yaw", "revolute", 2),
    ("base.pitch", "revolute", 1),
    ("base.roll", "revolute", 0),
)
"""Names, kinds and axes of the base's coordinates, from the ground to the base."""

FREE = len(COORDINATES)
"""How many they are."""

STEEPEST = np.deg2rad(80.0)
"""Pitch up to which yaw and roll are coordinates [rad]."""

UNIT = 1e-2
"""How far the length of a measured quaternion may be from one."""


def poses(found: Array) -> Array:
    """Positions and quaternions (w, x, y, z) of the base's frame, (M, 7): `coordinates` undone.

    Args:
        found: The six coordinates, (M, 6) [m, rad].
    """
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_euler("ZYX", found[:, 3:])
    return np.hstack([found[:, :3], turns.as_quat(scalar_first=True)])


def coordinates(base: Array) -> Array:
    """The six coordinates of poses, (M, 6) [m, rad]; angles without jumps.

    Args:
        base: Positions and quaternions (w, x, y, z) of the base's frame on the ground, (M, 7).

    Raises:
        RecordingError: A quaternion is none, or the base stands on its head, nearly.
    """
    from scipy.spatial.transform import Rotation

    size = np.linalg.norm(base[:, 3:], axis=1)
    wrong = np.flatnonzero(~(np.abs(size - 1) <= UNIT))
    if wrong.size:
        raise RecordingError(
            f"the base's quaternion has length {size[wrong[0]]:.3g} at sample {wrong[0]}, one of "
            f"{wrong.size} such: it is (w, x, y, z) of length one"
        )
    turns = Rotation.from_quat(base[:, 3:], scalar_first=True)
    if np.abs(turns.as_matrix()[:, 2, 0]).max(initial=0.0) > np.sin(STEEPEST):
        raise RecordingError(
            "the base's pitch goes beyond 80 degrees, where yaw and roll are no coordinates: turn "
            "the ground's frame, so that the base stands upright in it"
        )
    return np.hstack([base[:, :3], np.unwrap(turns.as_euler("ZYX"), axis=0)])
