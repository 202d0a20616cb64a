"""Limits of joint positions, velocities, accelerations and motor efforts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.errors import NoFeasibleMotion
from testbed.core.dynamics.newton_euler import Motion, joint_forces
from testbed.core.robot.drive_torque import drive_torque
from testbed.core.robot.tree import Joint, Tree

DEFAULT_LIMITS = {"revolute": (np.pi, 2.0, 6.0), "prismatic": (0.5, 0.5, 2.0)}
"""Default half range, velocity and acceleration of joints without limits, keyed by joint kind."""
MAX_RANGE_RATIO = 100.0
"""Largest ratio of a position limit to the default half range; a larger limit, such as 1e16 rad, is
treated as missing."""


RANDOM_POSTURES = 200
"""Number of random postures."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of joint positions, velocities, accelerations and motor efforts.

    Attributes:
        low: Smallest position, (n,) [rad or m].
        high: Largest position, (n,) [rad or m].
        velocity: Largest speed, (n,) [rad/s or m/s].
        acceleration: Largest acceleration, (n,) [rad/s^2 or m/s^2].
        effort: Largest absolute motor effort, (n,) [N m or N]; infinite for no limit.
    """

    low: Array
    high: Array
    velocity: Array
    acceleration: Array
    effort: Array

    def __post_init__(self) -> None:
        n = len(self.low)
        freeze_arrays(
            self, low=(n,), high=(n,), velocity=(n,), acceleration=(n,), effort=(n,)
        )

    @property
    def middle(self) -> Array:
        """Midpoints of the position ranges, (n,) [rad or m]."""
        return (self.low + self.high) / 2

    @property
    def half(self) -> Array:
        """Half widths of the position ranges, (n,) [rad or m]."""
        return (self.high - self.low) / 2

    @property
    def home(self) -> Array:
        """Zero posture, clipped to the position limits, (n,) [rad or m]."""
        return np.clip(np.zeros(len(self.low)), self.low, self.high)

    @property
    def postures(self) -> Array:
        """Home posture and random postures, (RANDOM_POSTURES + 1, n) [rad or m].

        Random postures are uniform within the position limits, with a fixed seed.
        """
        shape = RANDOM_POSTURES, len(self.low)
        random_postures = np.random.default_rng(0).uniform(self.low, self.high, shape)
        return np.vstack([self.home, random_postures])


def joint_limits(
    tree: Tree,
    velocity: Mapping[str, float] | None = None,
    acceleration: Mapping[str, float] | None = None,
) -> Limits:
    """Limits of the model file, reduced by user limits and completed by defaults.

    Defaults are DEFAULT_LIMITS; efforts have no default.

    Args:
        tree: The robot.
        velocity: Largest speeds, keyed by joint name [rad/s or m/s]; the smaller of this limit and
            the limit of the model file applies.
        acceleration: Largest accelerations, keyed by joint name [rad/s^2 or m/s^2]; model files
            state no acceleration limits.

    Raises:
        UnknownName: A limit is given for a joint that the robot does not have.
        NoFeasibleMotion: The position range of a joint is empty.
    """
    velocity, acceleration = velocity or {}, acceleration or {}
    for name in (*velocity, *acceleration):
        tree.index(name)

    def max_speed(joint: Joint) -> float:
        limit = min(joint.max_velocity, velocity.get(joint.name, np.inf))
        return limit if np.isfinite(limit) else DEFAULT_LIMITS[joint.kind][1]

    ranges = np.array([_position_range(joint) for joint in tree.joints])
    for joint, (low, high) in zip(tree.joints, ranges, strict=True):
        if low == high:
            raise NoFeasibleMotion(
                f"joint '{joint.name}' has no room to move: {low:g} to {high:g}"
            )
    return Limits(
        low=ranges[:, 0],
        high=ranges[:, 1],
        velocity=np.array([max_speed(joint) for joint in tree.joints]),
        acceleration=np.array(
            [acceleration.get(j.name, DEFAULT_LIMITS[j.kind][2]) for j in tree.joints]
        ),
        effort=np.array([joint.max_effort for joint in tree.joints]),
    )


def motor_efforts(tree: Tree, motion: Motion) -> Array:
    """Motor efforts along a motion, including friction and rotor inertia, (M, n) [N m or N]."""
    return joint_forces(tree, motion) + drive_torque(tree, motion.qd, motion.qdd)


def _position_range(joint: Joint) -> tuple[float, float]:
    """Finite position range of a joint; missing limits are replaced by default ranges.

    A limit beyond MAX_RANGE_RATIO times the default half range is treated as missing. If only one
    limit is given, the range extends from this limit over twice the default half range. If no limit
    is given, the range is symmetric about zero.
    """
    default_half = DEFAULT_LIMITS[joint.kind][0]
    low, high = (
        limit
        if abs(limit) <= MAX_RANGE_RATIO * default_half
        else np.copysign(np.inf, limit)
        for limit in joint.position_range
    )
    if np.isfinite(low) and np.isfinite(high):
        return low, high
    return (
        (low, low + 2 * default_half)
        if np.isfinite(low)
        else (min(high, default_half) - 2 * default_half, min(high, default_half))
    )
