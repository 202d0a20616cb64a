"""Rotations: roll, pitch and yaw as URDF has them; from the z axis to a direction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.robot.inertia import about

_X, _Y, _Z = np.eye(3)

LEVEL = 1e-9
"""Cosine of the pitch below which it is a right angle."""


def from_rpy(rpy: Sequence[float]) -> Array:
    """Turns about the fixed axes x, y, z in this order by three angles [rad], (3, 3)."""
    roll, pitch, yaw = rpy
    turn: Array = about(_Z, yaw) @ about(_Y, pitch) @ about(_X, roll)
    return turn


def to_rpy(turn: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation [rad].

    Roll first, then the others from what it leaves, so that they belong together; where the pitch
    is a right angle, and only roll and yaw together count, the roll is zero.
    """
    level = np.hypot(turn[2, 1], turn[2, 2]) > LEVEL
    roll = float(np.arctan2(turn[2, 1], turn[2, 2])) if level else 0.0
    rest = turn @ about(_X, -roll)
    yaw = float(np.arctan2(-rest[0, 1], rest[1, 1]))
    along = np.cos(yaw) * rest[0, 0] + np.sin(yaw) * rest[1, 0]
    return roll, float(np.arctan2(-rest[2, 0], along)), yaw


def align_z(direction: Array) -> Array:
    """Rotation that takes z to a direction, (3, 3).

    Args:
        direction: (3,), of any length but zero.
    """
    z = direction / np.linalg.norm(direction)
    other = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(other, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
