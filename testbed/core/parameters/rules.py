"""The rules: which parameters of a body stay, given how the body that carries it can move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array, apply, skew
from testbed.core.parameters.symbols import PARTS, TENSOR
from testbed.core.robot.tree import Joint, Tree

ALIGNED = 1e-9
"""Sine below which two directions count as parallel; also [m] for points on a line."""

TINY = 1e-9
"""Of unit forms: rounding of zero."""

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


def mobilities(tree: Tree, gravity: Array) -> tuple[Mobility, ...]:
    """The mobility ahead of every joint, from the axes of all joints before it at q = 0.

    Args:
        tree: The robot; only its geometry matters.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2].
    """
    poses = tree.zero_poses
    axes = np.array([X_WB.R_AB @ j.axis for X_WB, j in zip(poses, tree.joints, strict=True)])
    origins = np.array([X_WB.p_AB_A for X_WB in poses])
    revolute = np.array([joint.revolute for joint in tree.joints])
    found = []
    for j, parent in enumerate(tree.parents):
        ahead = list(tree.chain(parent))
        R_PW = poses[parent].R_AB.T if ahead else np.eye(3)
        arms = origins[ahead] - origins[j]
        found.append(_mobility(axes[j], axes[ahead], arms, revolute[ahead], gravity, R_PW))
    return tuple(found)


def _mobility(
    axis: Array, axes: Array, arms: Array, revolute: NDArray[np.bool_], gravity: Array, R_PW: Array
) -> Mobility:
    """The mobility ahead of a joint.

    Args:
        axis: Of the joint, (3,), bedplate frame W.
        axes: Of the joints ahead, (k, 3).
        arms: From O^j to their origins, (k, 3) [m].
        revolute: Which of them turn, (k,).
        gravity: (3,) [m/s^2].
        R_PW: Rotation from the bedplate's frame to the carrying body's.
    """
    rotation, direction = _rotation(axes[revolute], axis)
    one_line = (_sines(axes, axis) <= ALIGNED) & ((_sines(arms, axis) <= ALIGNED) | ~revolute)
    pulled = _sines(gravity, axis) > ALIGNED * np.linalg.norm(gravity)
    return Mobility(
        rotation,
        None if direction is None else R_PW @ direction,
        bool(one_line.all() and not pulled),
        None if gravity.any() or not revolute.all() else _pivot(axes, arms, axis),
    )


def _rotation(turning: Array, axis: Array) -> tuple[Rotation, Array | None]:
    """How the joints ahead turn a body, and about which direction if it is one.

    Args:
        turning: Axes of the revolute joints ahead, (k, 3).
        axis: Of the joint, (3,).
    """
    if not len(turning):
        return "none", None
    if (_sines(turning, turning[0]) > ALIGNED).any():
        return "free", None
    return "along" if _sines(turning[0], axis) <= ALIGNED else "across", turning[0]


def _pivot(axes: Array, arms: Array, axis: Array) -> float | None:
    """Where all axes ahead meet the joint's: distance from O^j [m]; None if nowhere, or along it.

    Args:
        axes: Of the joints ahead, all revolute, (k, 3).
        arms: From O^j to their origins, (k, 3) [m].
        axis: Of the joint, (3,).
    """
    inclined = np.flatnonzero(_sines(axes, axis) > ALIGNED)
    if not inclined.size:
        return None
    first = inclined[0]
    normal = np.cross(axis, axes[first])
    s = float(np.cross(arms[first], axes[first]) @ normal / (normal @ normal))
    return s if (_sines(arms - s * axis, axes) <= ALIGNED).all() else None


def _sines(a: Array, b: Array) -> Array:
    """Lengths of the cross products of vectors, (..., 3) both."""
    return np.asarray(np.linalg.norm(apply(skew(b), a), axis=-1))


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
        passed: Projector onto the part of mb^j that migrates, frame j, (3, 3).
        tensor: How K^j migrates: "all" of it, or the "mean" of the two moments across
            the axis, K_s of eq. (37); or "none".
        triad: What components are named after, frame j.
    """

    number: str
    kept: tuple[Kept, ...]
    passed: Array
    tensor: Literal["all", "mean", "none"]
    triad: Triad


def base_rule(functionals: Array) -> Row:
    """The row of a base that moves and whose wrench is measured: all ten where it moves freely.

    Args:
        functionals: What the wrench identifies of the base's ten parameters, (k, 10).
    """
    forms = _echelon(functionals)
    kept = tuple(
        Kept(
            tuple(
                (round(float(form[c]), 4), *PARTS[c])
                for c in sorted(np.flatnonzero(form).tolist(), key=lambda c: c != lead)
            ),
            form,
            np.eye(10)[lead],
        )
        for lead, form in sorted(forms.items())
    )
    return Row("free", kept, np.zeros((3, 3)), "none", _OWN)


def _echelon(rows: Array) -> dict[int, Array]:
    """Rows of the same space, each 1 at a column of its own where the others are 0, by column.

    Second moments lead before first ones, these before the mass.

    Args:
        rows: Orthonormal, (k, 10).
    """
    leads: list[int] = []
    for column in (*range(4, 10), 1, 2, 3, 0):
        if np.linalg.matrix_rank(rows[:, [*leads, column]], tol=TINY) > len(leads):
            leads.append(column)
    forms = np.linalg.solve(rows[:, leads], rows)
    return dict(zip(leads, np.where(np.abs(forms) < TINY, 0.0, forms), strict=True))


def rule(joint: Joint, mobility: Mobility, model: Model) -> Row:
    """The row that applies to a joint."""
    of_kind = _of_revolute if joint.revolute else _of_prismatic
    return of_kind(joint, mobility, model)


def _of_prismatic(joint: Joint, mobility: Mobility, model: Model) -> Row:
    """Tables 2, joint torques, and 3, bedplate reaction."""
    unit = np.eye(10)[0]
    mass = _kept(((1.0, "mbar", ""),), unit, axial=True)
    row = {"free": 1, "across": 2}.get(mobility.rotation, 3)
    number = f"{2 if model == 'dynamic' else 3}.{row}"
    if number == "2.3":
        return Row(number, (mass,), np.eye(3), "all", _OWN)
    if row == 1 or number == "3.2":
        return Row(number, (mass, *_moments(_OWN, 3)), np.zeros((3, 3)), "all", _OWN)
    direction = joint.axis
    if number == "2.2":
        assert mobility.direction is not None
        direction = joint.rotation.T @ mobility.direction
    triad, passed = across(direction), np.outer(direction, direction)
    return Row(number, (mass, *_moments(triad, 2)), passed, "all", triad)


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
    elif model == "dynamic" and mobility.pivot is not None:
        pairs = zip(oblique, reversed(moments), strict=True)
        about_pivot = (_sum(k, mobility.pivot, mb) for k, mb in pairs)
        number, kept = "4.4", (axial, difference, *about_pivot, product)
    return Row(number, kept, np.outer(joint.axis, joint.axis), "mean", triad)


ENTRIES = np.array([1, 1, 1, 1, 2, 1, 1, 2, 1, 2])
"""Factors from a form's coefficients to a multiple of the parameters dual to it: of a tensor's
numbers, those on the diagonal count twice."""


def _kept(terms: tuple[tuple[float, str, str], ...], form: Array, *, axial: bool = False) -> Kept:
    """A form of a triad's components, and the parameters for which it alone is 1."""
    direction = ENTRIES * form
    return Kept(terms, form, direction / (direction @ form), axial)


def _moments(triad: Triad, count: int) -> tuple[Kept, ...]:
    """Components of mb^j along the first directions of a triad."""
    forms = np.pad(triad.axes[:count], ((0, 0), (1, 6)))
    return tuple(
        _kept(((1.0, "mb", letter),), form)
        for letter, form in zip(triad.letters[:count], forms, strict=True)
    )


def _about_axis(
    triad: Triad,
) -> tuple[tuple[Kept, ...], Kept, Kept, tuple[Kept, Kept], Kept]:
    """What a revolute joint with axis e can keep, in the triad (u, v, e).

    Returns:
        (mb_u, mb_v), K_ee, 2 K_d = K_uu - K_vv, (K_ve, K_ue), K_uv.
    """
    (u, v, e), (p, q, r) = triad.axes, triad.letters
    spread = _tensor_form(u, u) - _tensor_form(v, v)
    difference = _kept(((2.0, "K", "d"),), spread)
    axial = _kept(((1.0, "K", r + r),), _tensor_form(e, e), axial=True)
    oblique = _product(v, e, q + r), _product(u, e, p + r)
    return _moments(triad, 2), axial, difference, oblique, _product(u, v, p + q)


def _product(a: Array, b: Array, letters: str) -> Kept:
    """K_ab; its letters in the order of the alphabet."""
    return _kept(((1.0, "K", "".join(sorted(letters))),), _tensor_form(a, b))


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

NOTHING_KEPT = Row("none", (), np.zeros((3, 3)), "none", _OWN)
"""Of what leads to a base and has no matter."""


def _tensor_form(a: Array, b: Array) -> Array:
    """The form a . K b on the ten parameters, (10,)."""
    return np.concatenate([np.zeros(4), np.einsum("a,abk,b->k", a, TENSOR, b)])
