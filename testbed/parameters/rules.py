"""The rules: which parameters of a body stay, and which move on to the body that carries it.

One function a table. Each answers with a `Row`: the parameters kept for joint j, the part
of mb^j and the part of K^j that migrate to body i.

Source    [FRS96] Tables 2-4; Table 5 and the row of Table 4 for weightlessness are derived
          here (docs/minimal-sets.md)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from testbed.arrays import Array
from testbed.parameters.barycentric import TENSOR_INDEX, UPPER
from testbed.parameters.mobility import ALIGNED, Mobility
from testbed.robot.tree import Joint

Model = Literal["dynamic", "reaction"]


REASONS = {
    "2.1": "slides on a body that turns about several directions",
    "2.2": "slides on a body that turns about one direction only, not the axis",
    "2.3": "slides on a body that turns about the axis only, or not at all",
    "3.1": "slides on a body that turns about several directions",
    "3.2": "slides on a body that turns about one direction only, not the axis",
    "3.3": "slides on a body that turns about the axis only, or not at all",
    "4.1": "turns on a body that turns about another direction, too",
    "4.2": "turns on a body that turns about the axis only, or not at all",
    "4.3": "turns on a body that turns about the axis only; nothing moves or pulls it across",
    "4.4": "turns on a body that turns about another direction, too, all about one resting point",
    "5.1": "turns on a body that turns about another direction, too",
    "5.2": "turns on a body that turns about the axis only, or not at all",
    "base": "the static wrench of all that stands on the bedplate",
}
"""Why a parameter is in the set: what the joint does, by table and row."""


@dataclass(frozen=True, eq=False)
class Kept:
    """One parameter kept: a linear form of body j's ten redefined parameters.

    Attributes:
        head: "mbar", "mb", "K" or "2*K".
        tail: Its component, as in mb2`y` or K3`yz`; "d" for half a difference.
        form: Coefficients on the ten parameters, (10,).
        direction: Ten parameters for which this form is 1, every other form kept for the
            joint 0, and nothing migrates, (10,).
        axial: Whether it is the inertia that the joint itself moves: K_ee, or mbar.
    """

    head: str
    tail: str
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
            the axis, K_s of eq. (37).
    """

    number: str
    kept: tuple[Kept, ...]
    passed: Array
    tensor: Literal["all", "mean"]


def rule(joint: Joint, mobility: Mobility, model: Model) -> Row:
    """The row that applies to a joint."""
    table = {
        (False, "dynamic"): _table2,
        (False, "reaction"): _table3,
        (True, "dynamic"): _table4,
        (True, "reaction"): _table5,
    }[joint.revolute, model]
    return table(joint, mobility)


def _table2(joint: Joint, mobility: Mobility) -> Row:
    """Prismatic, joint torques."""
    mass = _mass()
    if mobility.rotation == "free":
        return Row("2.1", (mass, *_moments(np.eye(3), "xyz")), np.zeros((3, 3)), "all")
    if mobility.rotation == "across":
        assert mobility.direction is not None
        w = joint.rotation.T @ mobility.direction
        u, v, names = across(w)
        return Row("2.2", (mass, *_moments(np.array([u, v]), names)), np.outer(w, w), "all")
    return Row("2.3", (mass,), np.eye(3), "all")


def _table3(joint: Joint, mobility: Mobility) -> Row:
    """Prismatic, bedplate reaction."""
    mass = _mass()
    if mobility.rotation in ("free", "across"):
        number = "3.1" if mobility.rotation == "free" else "3.2"
        return Row(number, (mass, *_moments(np.eye(3), "xyz")), np.zeros((3, 3)), "all")
    u, v, names = across(joint.axis)
    passed = np.outer(joint.axis, joint.axis)
    return Row("3.3", (mass, *_moments(np.array([u, v]), names)), passed, "all")


def _table4(joint: Joint, mobility: Mobility) -> Row:
    """Revolute, joint torques."""
    moments, axial, difference, oblique, product = _about_axis(joint.axis)
    passed = np.outer(joint.axis, joint.axis)
    if mobility.rotation in ("none", "along"):
        if mobility.at_rest:
            return Row("4.3", (axial,), passed, "mean")
        return Row("4.2", (*moments, axial), passed, "mean")
    if mobility.pivot is None:
        return Row("4.1", (*moments, axial, difference, *oblique, product), passed, "mean")
    about_pivot = tuple(
        _sum(k, mobility.pivot, mb) for k, mb in zip(oblique, reversed(moments), strict=True)
    )
    return Row("4.4", (axial, difference, *about_pivot, product), passed, "mean")


def _table5(joint: Joint, mobility: Mobility) -> Row:
    """Revolute, bedplate reaction."""
    moments, axial, difference, oblique, product = _about_axis(joint.axis)
    passed = np.outer(joint.axis, joint.axis)
    if mobility.rotation in ("none", "along"):
        return Row("5.2", (*moments, axial, *oblique), passed, "mean")
    return Row("5.1", (*moments, axial, difference, *oblique, product), passed, "mean")


def _mass() -> Kept:
    unit = np.eye(10)[0]
    return Kept("mbar", "", unit, unit, axial=True)


def _moments(directions: Array, names: str) -> tuple[Kept, ...]:
    """Components of mb^j along orthonormal directions, (k, 3)."""
    forms = np.pad(directions, ((0, 0), (1, 6)))
    return tuple(Kept("mb", name, form, form) for name, form in zip(names, forms, strict=True))


def _about_axis(
    axis: Array,
) -> tuple[tuple[Kept, ...], Kept, Kept, tuple[Kept, Kept], Kept]:
    """What a revolute joint with axis e can keep, in the triad (u, v, e).

    Returns:
        (mb_u, mb_v), K_ee, 2 K_d = K_uu - K_vv, (K_ve, K_ue), K_uv.
    """
    u, v, letters = across(axis)
    p, q = letters[0], letters[1]
    e = _letter(axis)
    between = {
        frozenset((p, q)): (u, v),
        frozenset((p, e)): (u, axis),
        frozenset((q, e)): (v, axis),
    }
    uv, ue, ve = (_product(*pair, "".join(sorted(key))) for key, pair in between.items())
    spread = _tensor_form(u, u) - _tensor_form(v, v)
    difference = Kept("2*K", "d", spread, (_tensor_part(u, u) - _tensor_part(v, v)) / 2)
    own = _tensor_form(axis, axis), _tensor_part(axis, axis)
    axial = Kept("K", e + e, *own, axial=True)
    return _moments(np.array([u, v]), p + q), axial, difference, (ve, ue), uv


def _product(a: Array, b: Array, tail: str) -> Kept:
    return Kept("K", tail, _tensor_form(a, b), _tensor_part(a, b) + _tensor_part(b, a))


def _sum(k: Kept, s: float, mb: Kept) -> Kept:
    """K_ae + s mb_a: a product of inertia about the pivot."""
    if abs(s) <= ALIGNED:
        return k
    return Kept(k.head, f"{k.tail}{s:+.6g}*mb_{mb.tail}", k.form + s * mb.form, k.direction)


def across(axis: Array) -> tuple[Array, Array, str]:
    """Two unit vectors that complete the unit vector `axis` to a triad, and their letters.

    Frame axes where `axis` is one, so that the parameters are the body's own components.
    """
    letter = _letter(axis)
    if letter in "xyz":
        p, q = (name for name in "xyz" if name != letter)
        return np.eye(3)["xyz".index(p)], np.eye(3)["xyz".index(q)], p + q
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    u = np.cross(helper, axis)
    u /= np.linalg.norm(u)
    return u, np.cross(axis, u), "uv"


def _letter(axis: Array) -> str:
    """x, y or z if the unit vector is plus or minus that body axis, else w."""
    strongest = int(np.argmax(np.abs(axis)))
    rest = np.delete(axis, strongest)
    return "xyz"[strongest] if np.linalg.norm(rest) <= ALIGNED else "w"


def _tensor_form(a: Array, b: Array) -> Array:
    """The form a . K b on the ten parameters, (10,)."""
    form = np.zeros(10)
    for r in range(3):
        for c in range(3):
            form[4 + TENSOR_INDEX[r][c]] += a[r] * b[c]
    return form


def _tensor_part(a: Array, b: Array) -> Array:
    """Ten parameters whose tensor is the symmetric part of a b', doubled if a is not b, (10,)."""
    tensor = (np.outer(a, b) + np.outer(b, a)) / 2
    return np.concatenate([np.zeros(4), tensor[UPPER]])
