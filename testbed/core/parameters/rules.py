"""Regrouping rules: kept parameters of a body, given the mobility of its carrier."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from testbed.core.base.arrays import Array, skew
from testbed.core.parameters.symbols import BARYCENTRIC_COMPONENTS, UPPER_TRIANGLE
from testbed.core.robot.tree import Joint, Tree

PARALLEL_TOLERANCE = 1e-9
"""Largest sine between parallel directions; largest distance from a point on a line [m]."""

ZERO_TOLERANCE = 1e-9
"""Largest coefficient of a unit form that is treated as zero."""

Rotation = Literal["none", "along", "across", "free"]


@dataclass(frozen=True, eq=False)
class Mobility:
    """Mobility of body i, which carries joint j, in frame j at q = 0.

    Gravity is treated as an acceleration of the bedplate, like a prismatic joint before all joints.

    Attributes:
        twists: Twists of frame j caused by a unit of gravity and by unit velocity of each joint
            before j, linear part first, (k, 6).
        axis: Axis of joint j, (3,).
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
        """Axes of rotation of body i relative to the joint axis.

        The values are "none" (no rotation), "along" (parallel to the joint axis), "across" (one
        direction that is not parallel to the joint axis) and "free" (several directions).
        """
        angular = self.twists[:, 3:]
        if not angular.any():
            return "none"
        if _normal_component(angular, self.direction) > PARALLEL_TOLERANCE:
            return "free"
        return (
            "along"
            if _normal_component(angular, self.axis) <= PARALLEL_TOLERANCE
            else "across"
        )

    @property
    def moves_axially(self) -> bool:
        """True if gravity and the motion of the joint's origin are along the joint axis."""
        return bool(
            _normal_component(self.twists[:, :3], self.axis) <= PARALLEL_TOLERANCE
        )

    @property
    def pivot(self) -> float | None:
        """Position along the axis, from O^j, of a point that never accelerates [m].

        The result is None if gravity or a joint before joint j accelerates every point of the axis.
        Body i must rotate about a direction that is not parallel to the axis.
        """
        linear, lever = self.twists[:, :3], self.twists[:, 3:] @ skew(self.axis)
        s = -float(np.sum(lever * linear) / np.sum(lever * lever))
        return (
            s
            if np.linalg.norm(linear + s * lever, axis=1).max() <= PARALLEL_TOLERANCE
            else None
        )


def _normal_component(vectors: Array, axis: Array) -> float:
    """Largest component of vectors, (k, 3), normal to a unit axis, (3,)."""
    return float(np.linalg.norm(vectors @ skew(axis), axis=1).max())


def mobilities(tree: Tree, gravity: Array) -> Iterator[Mobility]:
    """Yield the mobility of the body that carries each joint, in tree order.

    Args:
        tree: The robot.
        gravity: Gravity acceleration, (3,) [m/s^2], bedplate frame.
    """
    slide = gravity / (np.linalg.norm(gravity) or 1.0)
    twists = [np.concatenate([slide, np.zeros(3)])[None]]  # index j + 1
    for joint in tree.joints:
        carrier_twists = twists[joint.parent + 1] @ joint.X_PB.wrench_matrix
        yield Mobility(carrier_twists, joint.axis)
        twists.append(np.vstack([carrier_twists, unit_twist(joint)]))


def unit_twist(joint: Joint) -> Array:
    """Twist of a joint at unit velocity, in the joint frame, linear part first, (6,)."""
    zeros = np.zeros(3)
    return np.concatenate(
        [zeros, joint.axis] if joint.revolute else [joint.axis, zeros]
    )


Signal = Literal["wrench", "torque"]
"""Measured signal: wrench of the force plate, or joint torques.

The paper calls the corresponding methods external and internal, and the parameter sets reaction and
dynamic.
"""

SIGNALS: tuple[Signal, ...] = ("wrench", "torque")
"""Names of the measured signals."""


RULE_REASONS = {
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
"""Joint type and motion of the parent that put a parameter into the set, keyed by table and row."""


@dataclass(frozen=True, eq=False)
class Triad:
    """Orthonormal triad of a body, with letters that name components.

    Attributes:
        axes: Directions as rows, (3, 3); the last is the main direction, such as the joint axis.
        letters: Letters x, y, z in some order if the directions are the body axes, else u, v, w.
    """

    axes: Array
    letters: tuple[str, str, str]

    @property
    def is_inclined(self) -> bool:
        """True if the directions are not the body axes."""
        return self.letters == ("u", "v", "w")

    @property
    def R_BT(self) -> Array:
        """Rotation matrix of a right-handed frame T with z along the last direction, (3, 3)."""
        x, _, z = self.axes
        return np.column_stack([x, np.cross(z, x), z])


@dataclass(frozen=True, eq=False)
class KeptParameter:
    """Kept parameter: a linear form on body j's ten redefined parameters.

    Attributes:
        terms: Summands, each a factor, a kind ("mbar", "mb", "K") and a component, such as "y" or
            "yz" in the triad (u, v, w); "d" stands for (Kuu - Kvv) / 2.
        form: Coefficients on the ten parameters, (10,).
        direction: Ten parameters for which this form is 1, the other kept forms of the joint are
            0, and no parameter migrates, (10,).
        axial: True for the inertia that the joint accelerates: K_ee about its axis e, or mbar.
    """

    terms: tuple[tuple[float, str, str], ...]
    form: Array
    direction: Array
    axial: bool = False


@dataclass(frozen=True, eq=False)
class RuleRow:
    """Row of a rule table: kept parameters, and projector onto migrating parameters.

    Attributes:
        number: Table and row, a key of RULE_REASONS.
        parameters: Kept parameters of the joint, in printing order.
        migration_projector: Projector from the ten redefined parameters of body j onto those that
            migrate, (10, 10).
        triad: Directions, in frame j, along which components are taken and named.
    """

    number: str
    parameters: tuple[KeptParameter, ...]
    migration_projector: Array
    triad: Triad


def base_rule(functionals: Array) -> RuleRow:
    """Rule for a moving base whose wrench is measured.

    A base that moves freely keeps all ten parameters. Otherwise, the base keeps the combinations of
    a reduced row echelon form, with leading parameters in the order K, mb, mbar. No parameter
    migrates.

    Args:
        functionals: Identifiable functionals of the base's ten parameters, (k, 10).
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
        if np.linalg.matrix_rank(
            functionals[:, [*leads, column]], ZERO_TOLERANCE
        ) > len(leads):
            leads.append(column)
    forms = np.linalg.solve(functionals[:, leads], functionals)
    forms[np.abs(forms) < ZERO_TOLERANCE] = 0.0
    forms[:, leads] = np.eye(len(leads))
    parameters = []
    for lead, form in sorted(zip(leads, forms, strict=True), key=lambda pair: pair[0]):
        others = [c for c in np.flatnonzero(form).tolist() if c != lead]
        terms = tuple(
            (round(float(form[c]), 4), *BARYCENTRIC_COMPONENTS[c])
            for c in (lead, *others)
        )
        parameters.append(KeptParameter(terms, form, np.eye(10)[lead]))
    return RuleRow("free", tuple(parameters), np.zeros((10, 10)), _BODY_TRIAD)


def joint_rule(joint: Joint, mobility: Mobility, model: Signal) -> RuleRow:
    """Rule for a joint with the given mobility of its carrier.

    [FRS96] Tables 2 and 4 apply to joint torques, Tables 3 and 5 to the wrench. Tables 2 and 3
    apply to prismatic joints, Tables 4 and 5 to revolute joints.

    Args:
        joint: Joint j.
        mobility: Mobility of the body that carries joint j.
        model: "torque" or "wrench".
    """
    row_of_type = _revolute_row if joint.revolute else _prismatic_row
    return row_of_type(joint, mobility, model)


def _prismatic_row(joint: Joint, mobility: Mobility, model: Signal) -> RuleRow:
    """Row of [FRS96] Table 2 (torques) or 3 (wrench) for a prismatic joint.

    Row 1 applies to a carrier that rotates about several directions, row 2 to a carrier that
    rotates about one direction not parallel to the joint axis, row 3 to other carriers. The mass
    mbar is kept with all first moments (rows 2.1, 3.1, 3.2), with first moments normal to the
    direction of rotation (2.2) or to the joint axis (3.3), or alone (2.3). The inertia
    tensor is regrouped into the carrier.
    """
    unit = np.eye(10)[0]
    mass = KeptParameter(((1.0, "mbar", ""),), unit, unit, axial=True)
    row = {"free": 1, "across": 2}.get(mobility.rotation, 3)
    number = f"{2 if model == 'torque' else 3}.{row}"
    if number == "2.3":
        return RuleRow(number, (mass,), np.diag([0.0] + [1.0] * 9), _BODY_TRIAD)
    if row == 1 or number == "3.2":
        return RuleRow(
            number,
            (mass, *_first_moments(_BODY_TRIAD, 3)),
            _TENSOR_PROJECTOR,
            _BODY_TRIAD,
        )
    direction = mobility.direction if number == "2.2" else joint.axis
    triad = triad_about(direction)
    passed = _TENSOR_PROJECTOR + np.outer(
        _first_moment(direction), _first_moment(direction)
    )
    return RuleRow(number, (mass, *_first_moments(triad, 2)), passed, triad)


def _revolute_row(joint: Joint, mobility: Mobility, model: Signal) -> RuleRow:
    """Row of [FRS96] Table 4 (torques) or 5 (wrench) for a revolute joint.

    Let e be the joint axis. Rows 4.1 and 5.1 keep mb_u, mb_v, K_ee, K_uu - K_vv, K_ve, K_ue, K_uv.
    If the carrier rotates about e only, or not at all, row 4.2 keeps mb_u, mb_v, K_ee, and row 5.2
    in addition K_ve, K_ue; row 4.3 keeps K_ee alone if gravity and the motion of the joint are
    along e. If a point of the axis never accelerates, row 4.4, which is not in the paper, keeps the
    parameters of row 4.1 without mb_u, mb_v, and with K_ve, K_ue about that point.
    """
    triad = triad_about(joint.axis)
    moments, axial, difference, oblique, product = _axis_parameters(triad)
    parameters: tuple[KeptParameter, ...] = (
        *moments,
        axial,
        difference,
        *oblique,
        product,
    )
    number = "4.1" if model == "torque" else "5.1"
    if mobility.rotation in ("none", "along"):
        number, parameters = "4.2", (*moments, axial)
        if model == "wrench":
            number, parameters = "5.2", (*parameters, *oblique)
        elif mobility.moves_axially:
            number, parameters = "4.3", (axial,)
    elif model == "torque" and (pivot := mobility.pivot) is not None:
        pairs = zip(oblique, reversed(moments), strict=True)
        about_pivot = (_product_about_pivot(k, pivot, mb) for k, mb in pairs)
        number, parameters = "4.4", (axial, difference, *about_pivot, product)
    return RuleRow(number, parameters, _mean_and_moment_projector(triad), triad)


def _mean_and_moment_projector(triad: Triad) -> Array:
    """Projector onto the parameters that migrate over a revolute joint with axis e, (10, 10).

    In the triad (u, v, e), these are the mean K_s = (K_uu + K_vv)/2 of the inertias normal to the
    axis, [FRS96] eq. (37), and the first moment mb_e along the axis.
    """
    u, v, e = triad.axes
    tensor_sum, moment = (
        _symmetric_outer(u, u) + _symmetric_outer(v, v),
        _first_moment(e),
    )
    return np.outer(tensor_sum, _MULTIPLICITY * tensor_sum / 2) + np.outer(
        moment, moment
    )


def _first_moment(direction: Array) -> Array:
    """Ten parameters with first moment `direction`; also the form of mb along it, (10,)."""
    return np.concatenate([[0.0], direction, np.zeros(6)])


def _first_moments(triad: Triad, count: int) -> tuple[KeptParameter, ...]:
    """Components of the first moment mb^j along the first `count` directions of a triad."""
    pairs = list(zip(triad.letters, map(_first_moment, triad.axes), strict=True))
    return tuple(
        KeptParameter(((1.0, "mb", letter),), form, form)
        for letter, form in pairs[:count]
    )


def _axis_parameters(
    triad: Triad,
) -> tuple[
    tuple[KeptParameter, ...],
    KeptParameter,
    KeptParameter,
    tuple[KeptParameter, KeptParameter],
    KeptParameter,
]:
    """Parameters that a revolute joint with axis e can keep, in the triad (u, v, e).

    These are first moments mb and components of the inertia tensor K.

    Returns:
        Kept parameters (mb_u, mb_v), K_ee, 2 K_d = K_uu - K_vv, (K_ve, K_ue), K_uv.
    """
    (u, v, e), (p, q, r) = triad.axes, triad.letters
    difference_tensor, axial_tensor = (
        _symmetric_outer(u, u) - _symmetric_outer(v, v),
        _symmetric_outer(e, e),
    )
    difference = KeptParameter(
        ((2.0, "K", "d"),), _MULTIPLICITY * difference_tensor, difference_tensor / 2
    )
    axial = KeptParameter(
        ((1.0, "K", r + r),), _MULTIPLICITY * axial_tensor, axial_tensor, axial=True
    )
    oblique = _product_of_inertia(v, e, q + r), _product_of_inertia(u, e, p + r)
    return (
        _first_moments(triad, 2),
        axial,
        difference,
        oblique,
        _product_of_inertia(u, v, p + q),
    )


def _product_of_inertia(a: Array, b: Array, letters: str) -> KeptParameter:
    """Product of inertia K_ab as a kept parameter, named with letters in alphabetical order."""
    product = 2 * _symmetric_outer(a, b)
    return KeptParameter(
        ((1.0, "K", "".join(sorted(letters))),), _MULTIPLICITY * product / 2, product
    )


def _product_about_pivot(
    k: KeptParameter, s: float, mb: KeptParameter
) -> KeptParameter:
    """Product of inertia about the pivot, K_ae + s mb_a, as a kept parameter.

    Args:
        k: Product of inertia K_ae.
        s: Position of the pivot along the axis [m].
        mb: First moment mb_a.
    """
    if abs(s) <= PARALLEL_TOLERANCE:
        return k
    moment = tuple((s * factor, head, letter) for factor, head, letter in mb.terms)
    return KeptParameter((*k.terms, *moment), k.form + s * mb.form, k.direction)


def triad_about(axis: Array) -> Triad:
    """Triad whose last direction is the unit vector `axis`.

    If `axis` is along a body axis, the triad consists of the body axes, so that the parameters are
    components in the body frame. Otherwise, the triad is right-handed, and its first direction is
    normal to `axis` and to the body axis that makes the largest angle with `axis`.
    """
    strongest = int(np.argmax(np.abs(axis)))
    if np.linalg.norm(np.delete(axis, strongest)) <= PARALLEL_TOLERANCE:
        first, second = (k for k in range(3) if k != strongest)
        axes = np.array([np.eye(3)[first], np.eye(3)[second], axis])
        return Triad(axes, ("xyz"[first], "xyz"[second], "xyz"[strongest]))
    u = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    u /= np.linalg.norm(u)
    return Triad(np.array([u, np.cross(axis, u), axis]), ("u", "v", "w"))


_BODY_TRIAD = Triad(np.eye(3), ("x", "y", "z"))

_TENSOR_PROJECTOR = np.diag([0.0] * 4 + [1.0] * 6)
"""Projector onto the tensor K^j, (10, 10)."""

MASSLESS_ROW = RuleRow("none", (), np.zeros((10, 10)), _BODY_TRIAD)
"""Rule for a massless body between bedplate and base: no parameter is kept, none migrates."""


def _symmetric_outer(a: Array, b: Array) -> Array:
    """Ten parameters whose tensor is the symmetric part of a b', (10,)."""
    product = np.outer(a, b)
    return np.concatenate([np.zeros(4), ((product + product.T) / 2)[UPPER_TRIANGLE]])


_MULTIPLICITY = np.array([0, 0, 0, 0, 1, 2, 2, 1, 2, 1])
"""Number of elements of the tensor K that equal each of the ten parameters.

`_MULTIPLICITY * _symmetric_outer(a, b)` is the linear form a . K b.
"""
