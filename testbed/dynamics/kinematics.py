"""How every body moves: base to leaf, each in its own frame.

Source    [FRS96] eqs. (16), (29), (30); accelerations are absolute, gravity taken off
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import AnyArray, Array, apply, skew
from testbed.dynamics.algebra import NUMBERS, Algebra, Link, Skeleton


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """The motion of body j in frame j; leading axes are samples.

    Attributes:
        turn: From frame j to the carrying frame i, (..., 3, 3).
        z: Displacement of a prismatic joint, zero for a revolute one, (..., 3) [m].
        zdd: Absolute second derivative of z, (..., 3) [m/s^2].
        w: Angular velocity, (..., 3) [rad/s].
        wd: Angular acceleration, (..., 3) [rad/s^2].
        W: wd~ + w~ w~, (..., 3, 3) [1/s^2].
        a: xdd^j - g, acceleration of O^j less gravity, (..., 3) [m/s^2].
    """

    turn: AnyArray
    z: AnyArray
    zdd: AnyArray
    w: AnyArray
    wd: AnyArray
    W: AnyArray
    a: AnyArray


def kinematics(
    tree: Skeleton, q: AnyArray, qd: AnyArray, qdd: AnyArray, gravity: AnyArray, algebra: Algebra
) -> tuple[BodyMotion, ...]:
    """The motion of every body of the tree.

    Args:
        tree: The robot's geometry.
        q: Joint positions, (..., n) [rad or m], numbers or symbols.
        qd: Joint velocities, likewise.
        qdd: Joint accelerations, likewise.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2].
        algebra: Numbers or symbols.
    """
    still = np.zeros((*q.shape[:-1], 3), dtype=q.dtype)
    flat = np.zeros((*q.shape[:-1], 3, 3), dtype=q.dtype)
    bedplate = BodyMotion(flat, still, still, still, still, flat, still - gravity)
    moving: list[BodyMotion] = []
    for j, joint in enumerate(tree.joints):
        carrier = bedplate if joint.parent < 0 else moving[joint.parent]
        moving.append(_step(joint, j, carrier, q[..., j], qd[..., j], qdd[..., j], algebra))
    return tuple(moving)


def poses(tree: Skeleton, q: Array) -> list[tuple[Array, Array]]:
    """Rotation to the bedplate's axes (M, 3, 3) and position (M, 3) [m] of every body.

    Args:
        tree: The robot's geometry.
        q: Joint positions, (M, n) [rad or m].
    """
    still = np.zeros_like(q)
    moving = kinematics(tree, q, still, still, np.zeros(3), NUMBERS)
    found: list[tuple[Array, Array]] = []
    for joint, body in zip(tree.joints, moving, strict=True):
        base = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
        rotation, position = base if joint.parent < 0 else found[joint.parent]
        there = position + rotation @ joint.offset + apply(rotation @ body.turn, body.z)
        found.append((rotation @ body.turn, there))
    return found


def _step(
    joint: Link,
    j: int,
    carrier: BodyMotion,
    q: AnyArray,
    qd: AnyArray,
    qdd: AnyArray,
    algebra: Algebra,
) -> BodyMotion:
    """From body i to body j."""
    e, label = joint.axis, str(j + 1)
    turn = _turn(joint, q, algebra)
    back = np.swapaxes(turn, -1, -2)
    w, wd = apply(back, carrier.w), apply(back, carrier.wd)
    point = apply(back, carrier.a + apply(carrier.W, joint.offset))  # xdd - g of O'^j
    speed, rate = _along(e, qd), _along(e, qdd)
    if joint.revolute:
        wd = algebra.keep("wd" + label, wd + apply(skew(w), speed) + rate)
        w = algebra.keep("w" + label, w + speed)
        z = zdd = np.zeros_like(w)
    else:
        w, wd = algebra.keep("w" + label, w), algebra.keep("wd" + label, wd)
        z = _along(e, q)
        whirl = skew(wd) + skew(w) @ skew(w)
        zdd = algebra.keep("zdd" + label, apply(whirl, z) + 2 * apply(skew(w), speed) + rate)
    W = algebra.keep("W" + label, skew(wd) + skew(w) @ skew(w))
    return BodyMotion(turn, z, zdd, w, wd, W, algebra.keep("a" + label, point + zdd))


def _along(e: AnyArray, scalar: AnyArray) -> AnyArray:
    """Scalar times e.  scalar: (...); returns (..., 3)."""
    return np.asarray(scalar)[..., None] * e


def _turn(joint: Link, q: AnyArray, algebra: Algebra) -> AnyArray:
    """From frame j to frame i: A, times Rot(e, q) = e e' + c (1 - e e') + s e~ if revolute."""
    if not joint.revolute:
        fixed = np.broadcast_to(joint.rotation, (*np.shape(q), 3, 3))
        return fixed.astype(np.asarray(q).dtype)
    e = joint.axis
    c, s = (np.asarray(f(q))[..., None, None] for f in (algebra.cos, algebra.sin))
    axial = np.outer(e, e)
    rotation: AnyArray = joint.rotation @ (axial + c * (np.eye(3) - axial) + s * skew(e))
    return rotation
