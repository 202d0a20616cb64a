"""How the body that carries a joint can move: the question every rule asks first.

Mobility is judged over all joints ahead, at q = 0: whether the axes ahead of a joint are
all parallel, coaxial or concurrent does not depend on the posture when it is asked of the
whole chain (asked of the adjacent joint only, it does). What is known of a body is handed
on to the bodies it carries, so the cost grows linearly with their number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from testbed.arrays import Array
from testbed.robot.tree import Joint, Tree

ALIGNED = 1e-9
"""Sine below which two directions count as parallel; also [m] for points on a line."""

Rotation = Literal["none", "along", "across", "free"]


@dataclass(frozen=True, eq=False)
class Mobility:
    """What joint j's carrying body i can do, seen from the joint.

    Attributes:
        rotation: "none": body i never turns; "along": it turns only about directions
            parallel to the joint axis; "across": only about one direction, not parallel
            to the axis; "free": about more than one direction.
        direction: The one direction w, frame i, (3,); None unless "along" or "across".
        at_rest: xdd^j stays parallel to the joint axis in every motion, and so does gravity.
        pivot: Without gravity, the distance s along the axis from O^j to a point that
            never moves; None if there is no such point [m].
    """

    rotation: Rotation
    direction: Array | None
    at_rest: bool
    pivot: float | None


@dataclass(frozen=True, eq=False)
class _Line:
    """A line in the bedplate frame at q = 0, or one direction of lines (no point)."""

    direction: Array
    point: Array | None


@dataclass(frozen=True, eq=False)
class _Body:
    """What is known of a body from the joints up to its own.

    Attributes:
        turn: From its frame to the bedplate's, q = 0.
        origin: O^j in the bedplate frame, q = 0.
        spins: How it can turn: not at all (None), about one direction, or freely.
        screw: The line along and about which all its joints move; None if there are
            none, "no" if there is no such line.
        pivot: The line or point which none of its joints moves, if all are revolute; None
            if there are none, "no" if there is no such thing.
    """

    turn: Array
    origin: Array
    spins: Array | Literal["free"] | None
    screw: _Line | Literal["no"] | None
    pivot: _Line | Array | Literal["no"] | None


_BEDPLATE = _Body(np.eye(3), np.zeros(3), None, None, None)


def parallel(a: Array, b: Array) -> bool:
    """Whether two vectors are parallel or one of them is zero."""
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return _off(a, b) <= ALIGNED * scale


def mobilities(tree: Tree, gravity: Array) -> tuple[Mobility, ...]:
    """The mobility ahead of every joint.

    Args:
        tree: The robot.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2].
    """
    bodies: list[_Body] = []
    found: list[Mobility] = []
    weightless = not gravity.any()
    for joint in tree.joints:
        carrier = bodies[joint.parent] if joint.parent >= 0 else _BEDPLATE
        body = _placed(joint, carrier)
        axis = body.turn @ joint.axis
        found.append(_mobility(carrier, body.origin, axis, gravity))
        bodies.append(_moved(joint, carrier, body, axis, weightless))
    return tuple(found)


def _placed(joint: Joint, carrier: _Body) -> _Body:
    turn = carrier.turn @ joint.rotation
    return replace(carrier, turn=turn, origin=carrier.origin + carrier.turn @ joint.offset)


def _mobility(carrier: _Body, origin: Array, axis: Array, gravity: Array) -> Mobility:
    rotation: Rotation
    direction = None
    if carrier.spins is None:
        rotation = "none"
    elif isinstance(carrier.spins, str):
        rotation = "free"
    else:
        rotation = "along" if parallel(carrier.spins, axis) else "across"
        direction = carrier.turn.T @ carrier.spins
    screw = carrier.screw
    steady = screw is None or (
        isinstance(screw, _Line)
        and parallel(screw.direction, axis)
        and (screw.point is None or _off(screw.point - origin, axis) <= ALIGNED)
    )
    pivot = None if gravity.any() else _pivot(carrier.pivot, origin, axis)
    return Mobility(rotation, direction, steady and parallel(gravity, axis), pivot)


def _moved(joint: Joint, carrier: _Body, body: _Body, axis: Array, weightless: bool) -> _Body:
    """What is known of body j, from body i and joint j."""
    spins, screw = carrier.spins, carrier.screw
    if joint.revolute:
        if spins is None:
            spins = axis
        elif not isinstance(spins, str) and not parallel(spins, axis):
            spins = "free"
    here = body.origin if joint.revolute else None
    if screw is None:
        screw = _Line(axis, here)
    elif isinstance(screw, _Line):
        screw = _common(screw, axis, here)
    pivot = _fixed(joint, carrier.pivot, body.origin, axis) if weightless else "no"
    return replace(body, spins=spins, screw=screw, pivot=pivot)


def _common(screw: _Line, axis: Array, here: Array | None) -> _Line | Literal["no"]:
    """The line of the joints ahead, if joint j keeps to it; a slide has no point (None)."""
    if not parallel(screw.direction, axis):
        return "no"
    if here is None or screw.point is None:
        return _Line(axis, screw.point if here is None else here)
    return screw if _off(screw.point - here, axis) <= ALIGNED else "no"


def _fixed(
    joint: Joint, ahead: _Line | Array | Literal["no"] | None, origin: Array, axis: Array
) -> _Line | Array | Literal["no"] | None:
    """What neither the joints ahead nor joint j move."""
    if not joint.revolute or isinstance(ahead, str):
        return "no"
    if ahead is None:
        return _Line(axis, origin)
    if isinstance(ahead, _Line) and parallel(ahead.direction, axis):
        assert ahead.point is not None
        return ahead if _off(ahead.point - origin, axis) <= ALIGNED else "no"
    s = _pivot(ahead, origin, axis)
    return "no" if s is None else origin + s * axis


def _pivot(ahead: _Line | Array | Literal["no"] | None, origin: Array, axis: Array) -> float | None:
    """Where axis j meets what the joints ahead leave fixed: distance from O^j [m]."""
    if ahead is None or isinstance(ahead, str):
        return None
    if isinstance(ahead, _Line):
        assert ahead.point is not None
        normal = np.cross(ahead.direction, axis)
        if float(np.sqrt(normal @ normal)) <= ALIGNED:
            return None
        gap = ahead.point - origin
        s = float(np.cross(gap, ahead.direction) @ np.cross(axis, ahead.direction))
        s /= float(normal @ normal)
        return s if _off(gap - s * axis, ahead.direction) <= ALIGNED else None
    gap = ahead - origin
    return float(gap @ axis) if _off(gap, axis) <= ALIGNED else None


def _off(a: Array, b: Array) -> float:
    """Length of a x b."""
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    return float(np.sqrt(x * x + y * y + z * z))
