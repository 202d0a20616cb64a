"""Limits of positions, velocities, accelerations and motor efforts, joint by joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.errors import InfeasibleMotion
from testbed.core.dynamics.newton_euler import Motion, joint_forces
from testbed.core.robot.drive_torque import drive_torque
from testbed.core.robot.tree import Joint, Tree

CALM = {"revolute": (np.pi, 2.0, 6.0), "prismatic": (0.5, 0.5, 2.0)}
"""Half range, velocity and acceleration where neither file nor user gives a limit."""
ENDLESS = 100.0
"""Times that half range: a range beyond is none, as the 1e16 rad of a rotor that turns freely."""


POSTURES = 200
"""Random postures that are tried."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds on positions, velocities, accelerations and efforts, joint by joint.

    Attributes:
        low: Least position, (n,) [rad or m].
        high: Greatest position, (n,) [rad or m].
        velocity: Greatest speed, (n,) [rad/s or m/s].
        acceleration: Greatest acceleration, (n,) [rad/s^2 or m/s^2].
        effort: Greatest motor effort, (n,) [N m or N].
    """

    low: Array
    high: Array
    velocity: Array
    acceleration: Array
    effort: Array

    def __post_init__(self) -> None:
        n = len(self.low)
        freeze(self, low=(n,), high=(n,), velocity=(n,), acceleration=(n,), effort=(n,))

    @property
    def middle(self) -> Array:
        """Of the ranges of positions, (n,) [rad or m]."""
        return (self.low + self.high) / 2

    @property
    def half(self) -> Array:
        """Half the ranges of positions, (n,) [rad or m]."""
        return (self.high - self.low) / 2

    @property
    def home(self) -> Array:
        """The posture of zeros, or what is nearest to it within the limits, (n,) [rad or m]."""
        return np.clip(np.zeros(len(self.low)), self.low, self.high)

    @property
    def postures(self) -> Array:
        """The posture of zeros and random ones, the same every time, (POSTURES + 1, n)."""
        shape = POSTURES, len(self.low)
        random = np.random.default_rng(0).uniform(self.low, self.high, shape)
        return np.vstack([self.home, random])


def limits_of(
    tree: Tree,
    velocity: Mapping[str, float] | None = None,
    acceleration: Mapping[str, float] | None = None,
) -> Limits:
    """The model file's limits, narrowed by the user's, completed by calm defaults.

    Args:
        tree: The robot.
        velocity: Greatest speed by joint name [rad/s or m/s].
        acceleration: Greatest acceleration by joint name [rad/s^2 or m/s^2].

    Raises:
        UnknownName: A limit is given for a joint that the robot lacks.
        InfeasibleMotion: A joint has no room to move.
    """
    velocity, acceleration = velocity or {}, acceleration or {}
    for name in (*velocity, *acceleration):
        tree.index(name)

    def speed(joint: Joint) -> float:
        known = min(joint.max_velocity, velocity.get(joint.name, np.inf))
        return known if np.isfinite(known) else CALM[joint.kind][1]

    ranges = np.array([_range(joint) for joint in tree.joints])
    for joint, (low, high) in zip(tree.joints, ranges, strict=True):
        if low == high:
            raise InfeasibleMotion(
                f"joint '{joint.name}' has no room to move: {low:g} to {high:g}"
            )
    return Limits(
        low=ranges[:, 0],
        high=ranges[:, 1],
        velocity=np.array([speed(joint) for joint in tree.joints]),
        acceleration=np.array(
            [acceleration.get(j.name, CALM[j.kind][2]) for j in tree.joints]
        ),
        effort=np.array([joint.max_effort for joint in tree.joints]),
    )


def motor_efforts(tree: Tree, motion: Motion) -> Array:
    """What the motors must deliver, friction and rotor inertia included, (M, n) [N m or N]."""
    return joint_forces(tree, motion) + drive_torque(tree, motion.qd, motion.qdd)


def _range(joint: Joint) -> tuple[float, float]:
    half = CALM[joint.kind][0]
    low, high = (
        end if abs(end) <= ENDLESS * half else np.copysign(np.inf, end)
        for end in joint.position_range
    )
    if np.isfinite(low) and np.isfinite(high):
        return low, high
    return (
        (low, low + 2 * half)
        if np.isfinite(low)
        else (min(high, half) - 2 * half, min(high, half))
    )
