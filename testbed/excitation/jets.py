"""How fast forces can change: bounds of their second derivatives, proven.

A jet holds bounds of the magnitudes of a quantity and of its first two derivatives by time. The
equations of Newton and Euler are followed with jets in place of vectors: sums add, products obey
Leibniz' rule, a rotation has the magnitude one. What comes out bounds the true values, whatever
the motion does between its samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.robot.tree import Joint, Tree


@dataclass(frozen=True, eq=False)
class ForceBounds:
    """Bounds of the magnitudes of second derivatives, in W spans of time.

    Attributes:
        joints: Of the joints' forces, drives and friction aside, (n, W) [N m/s^2 or N/s^2].
        force: Of the bedplate's force, (W,) [N/s^2].
        moment: Of its moment about O^0, (W,) [N m/s^2].
        motion: Of the joints' derivatives of order 0 to 4 themselves, (5, n, W).
    """

    joints: Array
    force: Array
    moment: Array
    motion: Array


def force_bounds(tree: Tree, motion: Array) -> ForceBounds:
    """Bounds of how fast forces change.

    Args:
        tree: The robot, its inertias an a-priori model.
        motion: Bounds of |q|, |qd|, |qdd| and of the next two derivatives, (5, n, W).
    """
    still = np.zeros((3, motion.shape[2]))
    falling = still.copy()
    falling[0] = np.linalg.norm(tree.gravity)
    ground = _Moving(still, still, falling, still, still)
    moving: list[_Moving] = []
    for joint, own in zip(tree.joints, motion.transpose(1, 0, 2), strict=True):
        carrier = ground if joint.parent < 0 else moving[joint.parent]
        moving.append(_carried(joint, carrier, own))
    force, moment = np.zeros((2, tree.n + 1, *still.shape))  # the last one is the bedplate's
    joints = np.empty((tree.n, motion.shape[2]))
    for j in reversed(range(tree.n)):
        joint, body, here = tree.joints[j], tree.inertias[j], moving[j]
        first = float(np.linalg.norm(body.first_moment))
        second = float(np.linalg.norm(body.tensor, 2))
        force[j] += abs(body.mass) * here.linear + first * here.turning
        moment[j] += first * here.linear + second * (here.angular + _times(here.speed, here.speed))
        joints[j] = (moment if joint.revolute else force)[j, 2]
        passed = _times(here.rotation, force[j])
        force[joint.parent] += passed
        moment[joint.parent] += _times(here.rotation, moment[j]) + _times(here.lever, passed)
    return ForceBounds(joints, force[-1, 2], moment[-1, 2], motion)


@dataclass(frozen=True, eq=False)
class _Moving:
    """Jets of a body's motion, (3, W) each, in its own axes."""

    speed: Array  # angular velocity
    angular: Array  # angular acceleration
    linear: Array  # acceleration of its origin less gravity
    rotation: Array  # from its axes to its carrier's
    lever: Array  # from its carrier's origin to its own

    @property
    def turning(self) -> Array:
        """What a point a metre away has more of acceleration."""
        return np.asarray(self.angular + _times(self.speed, self.speed))


def _carried(joint: Joint, carrier: _Moving, own: Array) -> _Moving:
    """The jets of a body on its carrier; `own` are bounds of its joint's derivatives, (5, W)."""
    position, speed, acceleration = own[:3], own[1:4], own[2:5]
    lever = np.zeros_like(position)
    lever[0] = np.linalg.norm(joint.offset)
    rotation = np.zeros_like(position)
    rotation[0] = 1.0
    if joint.revolute:
        rotation[1], rotation[2] = own[1], own[2] + own[1] ** 2
        turned = _times(rotation, carrier.speed)
        angular = _times(rotation, carrier.angular) + _times(turned, speed) + acceleration
        linear = _times(rotation, carrier.linear + _times(carrier.turning, lever))
        return _Moving(turned + speed, angular, linear, rotation, lever)
    lever = lever + position
    linear = carrier.linear + _times(carrier.turning, lever) + acceleration
    linear = linear + 2 * _times(carrier.speed, speed)
    return _Moving(carrier.speed, carrier.angular, linear, rotation, lever)


def _times(a: Array, b: Array) -> Array:
    """The jet of a product."""
    second = a[2] * b[0] + 2 * a[1] * b[1] + a[0] * b[2]
    return np.stack([a[0] * b[0], a[1] * b[0] + a[0] * b[1], second])
