"""The rules: which parameters of a body stay, given how the body that carries it can move."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from testbed.core.base.arrays import Array, skew
from testbed.core.parameters.symbols import PARTS, UPPER
from testbed.core.robot.tree import Joint, Tree

ALIGNED = 1e-9
"""Sine below which two directions count as parallel; also [m] for points on a line."""

TINY = 1e-9
"""Of unit forms: rounding of zero."""

Rotation = Literal["none", "along", "across", "free"]


@dataclass(frozen=True, eq=False)
class Mobility:
    """Motion of the body i that carries joint j, seen from the joint's frame j at q = 0.

    Gravity is an acceleration of the bedplate: it counts as a slide before all joints.

    Attributes:
        twists: Of frame j by a unit of gravity and of every joint before j, linear part first,
            (k, 6).
        axis: Of joint j, (3,).
    """

    twists: Array
    axis: Array

    @property
    def direction(self) -> Array:
        """Axis of the first rotation before joint j, (3,)."""
        angular = self.twists[:, 3:]
        first: Array = angular[np.flatnonzero(angular.any(axis=1))[0]]
        return first

    @property
    def rotation(self) -> Rotation:
        """Directions about which body i turns.

        "none"; "along": parallel to the joint axis; "across": one, not parallel to the axis;
        "free": several.
        """
        angular = self.twists[:, 3:]
        if not angular.any():
            return "none"
        if _distance(angular, self.direction) > ALIGNED:
            return "free"
        return "along" if _distance(angular, self.axis) <= ALIGNED else "across"

    @property
    def at_rest(self) -> bool:
        """Whether neither gravity nor, where body i turns along the axis, xdd^j is across it."""
        return bool(_distance(self.twists[:, :3], self.axis) <= ALIGNED)

    @property
    def pivot(self) -> float | None:
        """Distance from O^j along the axis of a point that never accelerates [m].

        None where there is none; body i turns across the axis.
        """
        linear, lever = self.twists[:, :3], self.twists[:, 3:] @ skew(self.axis)
        s = -float(np.sum(lever * linear) / np.sum(lever * lever))
        return (
            s if np.linalg.norm(linear + s * lever, axis=1).max() <= ALIGNED else None
        )


def _distance(vectors: Array, axis: Array) -> float:
    """Largest component of vectors, (k, 3), across a unit axis."""
    return float(np.linalg.norm(vectors @ skew(axis), axis=1).max())


def mobilities(tree: Tree, gravity: Array) -> Iterator[Mobility]:
    """The mobility ahead of every joint.

    Args:
        tree: The robot.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2].
    """
    slide = gravity / (np.linalg.norm(gravity) or 1.0)
    twists = [np.concatenate([slide, np.zeros(3)])[None]]  # index j + 1
    for joint in tree.joints:
        ahead = twists[joint.parent + 1] @ joint.X_PB.wrench_matrix
        yield Mobility(ahead, joint.axis)
        twists.append(np.vstack([ahead, unit_twist(joint)]))


def unit_twist(joint: Joint) -> Array:
    """Twist of a joint at unit velocity in its own frame, linear part first, (6,)."""
    nothing = np.zeros(3)
    return np.concatenate(
        [nothing, joint.axis] if joint.revolute else [joint.axis, nothing]
    )


Model = Literal["dynamic", "reaction"]

Signal = Literal["wrench", "torque"]
"""What is measured: the plate's wrench, or joint torques."""

MODEL_OF: Mapping[str, Model] = {"wrench": "reaction", "torque": "dynamic"}
"""Minimal set by signal."""


REASONS = {
    "2.1": "prismatic; its parent rotates about several directions",
    "2.2": "prismatic; its parent rotates about one direction only, not along the joint axis",
    "2.3": "prismatic; its parent rotates about the joint axis only, or not at all",
    "3.1": "prismatic; its parent rotates about several directions",
    "3.2": "prismatic; its parent rotates about one direction only, not along the joint axis",
    "3.3": "prismatic; its parent rotates about the joint axis only, or not at all",
    "4.1": "revolute; its parent also rotates about a non-parallel axis",
    "4.2": "revolute; its parent rotates about the joint axis only, or not at all",
    "4.3": "revolute; its parent rotates about the joint axis only, not accelerated across it",
    "4.4": "revolute; its parent also rotates about a non-parallel axis, about one fixed point",
    "5.1": "revolute; its parent also rotates about a non-parallel axis",
    "5.2": "revolute; its parent rotates about the joint axis only, or not at all",
    "free": "the base beyond a force sensor, or of a robot with a free root",
    "none": "a joint before the force sensor or a coordinate of a free base, without mass",
    "base": "the static wrench of all that stands on the bedplate",
}
"""Why a parameter is in the set: what the joint does, by table and row."""


@dataclass(frozen=True, eq=False)
class Triad:
    """Three orthonormal directions of a body, and the letters that name components along them.

    Attributes:
        axes: As rows, (3, 3); the last is the direction that the first two stand across.
        letters: x, y, z in some order where the axes are the body's own, else u, v, w.
    """

    axes: Array
    letters: tuple[str, str, str]

    @property
    def inclined(self) -> bool:
        """Whether the axes are others than the body's own."""
        return self.letters == ("u", "v", "w")

    @property
    def R_BT(self) -> Array:
        """Right-handed frame T with z along the last direction, in the body's frame B, (3, 3)."""
        x, _, z = self.axes
        return np.column_stack([x, np.cross(z, x), z])


@dataclass(frozen=True, eq=False)
class Kept:
    """One parameter kept: a linear form of body j's ten redefined parameters.

    Attributes:
        terms: What it is the sum of: factor, head ("mbar", "mb", "K") and component, such as
            "y" or "yz" in the row's triad; "d" for half a difference.
        form: Coefficients on the ten parameters, (10,).
        direction: Ten parameters for which this form is 1, every other form kept for the
            joint 0, and nothing migrates, (10,).
        axial: Whether it is the inertia that the joint itself moves: K_ee, or mbar.
    """

    terms: tuple[tuple[float, str, str], ...]
    form: Array
    direction: Array
    axial: bool = False


@dataclass(frozen=True, eq=False)
class Row:
    """One row of a table.

    Attributes:
        number: Table and row, a key of REASONS.
        kept: The parameters kept for the joint, in printing order.
        passed: Projector of body j's ten redefined parameters onto what migrates, (10, 10).
        triad: What components are named after, frame j.
    """

    number: str
    kept: tuple[Kept, ...]
    passed: Array
    triad: Triad


def base_rule(functionals: Array) -> Row:
    """The row of a base that moves and whose wrench is measured: all ten where it moves freely.

    Args:
        functionals: What the wrench identifies of the base's ten parameters, (k, 10).
    """
    leads: list[int] = []
    # second moments before first ones and the mass
    for column in (
        *range(4, 10),
        1,
        2,
        3,
        0,
    ):
        if np.linalg.matrix_rank(functionals[:, [*leads, column]], TINY) > len(leads):
            leads.append(column)
    forms = np.linalg.solve(functionals[:, leads], functionals)
    forms[np.abs(forms) < TINY] = 0.0
    forms[:, leads] = np.eye(len(leads))
    kept = []
    for lead, form in sorted(zip(leads, forms, strict=True), key=lambda pair: pair[0]):
        others = [c for c in np.flatnonzero(form).tolist() if c != lead]
        terms = tuple((round(float(form[c]), 4), *PARTS[c]) for c in (lead, *others))
        kept.append(Kept(terms, form, np.eye(10)[lead]))
    return Row("free", tuple(kept), np.zeros((10, 10)), _OWN)


def rule(joint: Joint, mobility: Mobility, model: Model) -> Row:
    """The row that applies to a joint."""
    of_kind = _of_revolute if joint.revolute else _of_prismatic
    return of_kind(joint, mobility, model)


def _of_prismatic(joint: Joint, mobility: Mobility, model: Model) -> Row:
    """Tables 2, joint torques, and 3, bedplate reaction."""
    unit = np.eye(10)[0]
    mass = Kept(((1.0, "mbar", ""),), unit, unit, axial=True)
    row = {"free": 1, "across": 2}.get(mobility.rotation, 3)
    number = f"{2 if model == 'dynamic' else 3}.{row}"
    if number == "2.3":
        return Row(number, (mass,), np.diag([0.0] + [1.0] * 9), _OWN)
    if row == 1 or number == "3.2":
        return Row(number, (mass, *_moments(_OWN, 3)), _TENSOR, _OWN)
    direction = mobility.direction if number == "2.2" else joint.axis
    triad = across(direction)
    passed = _TENSOR + np.outer(_moment(direction), _moment(direction))
    return Row(number, (mass, *_moments(triad, 2)), passed, triad)


def _of_revolute(joint: Joint, mobility: Mobility, model: Model) -> Row:
    """Tables 4, joint torques, and 5, bedplate reaction."""
    triad = across(joint.axis)
    moments, axial, difference, oblique, product = _about_axis(triad)
    kept: tuple[Kept, ...] = (*moments, axial, difference, *oblique, product)
    number = "4.1" if model == "dynamic" else "5.1"
    if mobility.rotation in ("none", "along"):
        number, kept = "4.2", (*moments, axial)
        if model == "reaction":
            number, kept = "5.2", (*kept, *oblique)
        elif mobility.at_rest:
            number, kept = "4.3", (axial,)
    elif model == "dynamic" and (pivot := mobility.pivot) is not None:
        pairs = zip(oblique, reversed(moments), strict=True)
        about_pivot = (_sum(k, pivot, mb) for k, mb in pairs)
        number, kept = "4.4", (axial, difference, *about_pivot, product)
    return Row(number, kept, _mean_and_moment(triad), triad)


def _mean_and_moment(triad: Triad) -> Array:
    """Projector onto K_s = (K_uu + K_vv)/2, eq. (37), and mb_e of a triad (u, v, e)."""
    u, v, e = triad.axes
    across, moment = _outer(u, u) + _outer(v, v), _moment(e)
    return np.outer(across, _TIMES * across / 2) + np.outer(moment, moment)


def _moment(direction: Array) -> Array:
    """Ten parameters whose mb is a direction, and the form of mb along it, (10,)."""
    return np.concatenate([[0.0], direction, np.zeros(6)])


def _moments(triad: Triad, count: int) -> tuple[Kept, ...]:
    """Components of mb^j along the first directions of a triad."""
    pairs = list(zip(triad.letters, map(_moment, triad.axes), strict=True))
    return tuple(
        Kept(((1.0, "mb", letter),), form, form) for letter, form in pairs[:count]
    )


def _about_axis(
    triad: Triad,
) -> tuple[tuple[Kept, ...], Kept, Kept, tuple[Kept, Kept], Kept]:
    """What a revolute joint with axis e can keep, in the triad (u, v, e).

    Returns:
        (mb_u, mb_v), K_ee, 2 K_d = K_uu - K_vv, (K_ve, K_ue), K_uv.
    """
    (u, v, e), (p, q, r) = triad.axes, triad.letters
    spread, along = _outer(u, u) - _outer(v, v), _outer(e, e)
    difference = Kept(((2.0, "K", "d"),), _TIMES * spread, spread / 2)
    axial = Kept(((1.0, "K", r + r),), _TIMES * along, along, axial=True)
    oblique = _product(v, e, q + r), _product(u, e, p + r)
    return _moments(triad, 2), axial, difference, oblique, _product(u, v, p + q)


def _product(a: Array, b: Array, letters: str) -> Kept:
    """K_ab; its letters in the order of the alphabet."""
    product = 2 * _outer(a, b)
    return Kept(((1.0, "K", "".join(sorted(letters))),), _TIMES * product / 2, product)


def _sum(k: Kept, s: float, mb: Kept) -> Kept:
    """K_ae + s mb_a: a product of inertia about the pivot."""
    if abs(s) <= ALIGNED:
        return k
    moment = tuple((s * factor, head, letter) for factor, head, letter in mb.terms)
    return Kept((*k.terms, *moment), k.form + s * mb.form, k.direction)


def across(axis: Array) -> Triad:
    """A triad whose last direction is the unit vector `axis`.

    Frame axes where `axis` is one, so that the parameters are the body's own components.
    """
    strongest = int(np.argmax(np.abs(axis)))
    if np.linalg.norm(np.delete(axis, strongest)) <= ALIGNED:
        first, second = (k for k in range(3) if k != strongest)
        axes = np.array([np.eye(3)[first], np.eye(3)[second], axis])
        return Triad(axes, ("xyz"[first], "xyz"[second], "xyz"[strongest]))
    u = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    u /= np.linalg.norm(u)
    return Triad(np.array([u, np.cross(axis, u), axis]), ("u", "v", "w"))


_OWN = Triad(np.eye(3), ("x", "y", "z"))

_TENSOR = np.diag([0.0] * 4 + [1.0] * 6)
"""Projector onto K^j."""

NOTHING_KEPT = Row("none", (), np.zeros((10, 10)), _OWN)
"""Of what leads to a base and has no matter."""


def _outer(a: Array, b: Array) -> Array:
    """Ten parameters whose tensor is the symmetric part of a b', (10,)."""
    product = np.outer(a, b)
    return np.concatenate([np.zeros(4), ((product + product.T) / 2)[UPPER]])


_TIMES = np.array([0, 0, 0, 0, 1, 2, 2, 1, 2, 1])
"""Times that each of the ten parameters stands in its tensor: _TIMES * _outer(a, b) is a . K b."""
