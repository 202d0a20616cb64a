"""The exact recursion: a second witness of the minimal set, sharing no code with the rules.

Works on composite bodies (a body and all it carries, stiff), with the ten numbers
(m, h, I) about the body frame's origin, and asks from the bedplate outwards:

V_j   which twists frame j can be given by the joints ahead, by its own and by gravity;
Z_j   which functionals of composite j are seen: v . I_j S_j for every v in V_j, and what
      changes, as joint j moves, of any functional seen of the carrying composite;
K_j   all functionals of composite j that enter any measurement.

Of V_j two members are kept apart, the joint's own acceleration and gravity as it is at
q = 0: what only these show of a body, its drive's rotor or offset may hide.

The joint torques see the Z_j P_j; the bedplate sees them with V_j the whole space, and
K_0 P_0, its own static wrench.

Source    derived for this project (docs/minimal-sets.md)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.arrays import Array, skew
from testbed.parameters.barycentric import STANDARD, TENSOR, UPPER, to_standard
from testbed.parameters.row_space import Space, row_space
from testbed.parameters.rules import Model
from testbed.robot.tree import Joint, Tree

NEW = 1e-8
"""Part of a unit functional that must be left after projection for it to be a new one."""


_INERTIA = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")


@dataclass(frozen=True, eq=False)
class SeenWrench:
    """Functionals of composite j, at q = 0, that a measurement identifies; rows on (m, h, I).

    Attributes:
        aside: Identifiable whatever joint j's own acceleration and its weight at q = 0, (k, 10).
        inertia: S_j . I_j S_j, the factor of qdd_j in row j, (10,).
        weight: -g . I_j S_j with gravity g as it is at q = 0: the constant in row j, (10,).
    """

    aside: Array
    inertia: Array
    weight: Array

    @property
    def whole(self) -> Array:
        """All of them, orthonormal, (k, 10)."""
        return _span(np.vstack([self.aside, self.inertia, self.weight]))


def recursive_space(
    tree: Tree,
    model: Model,
    gravity: ArrayLike | None = None,
    *,
    tared: bool = False,
    known_zero: NDArray[np.bool_] | None = None,
) -> Space:
    """What a measurement can identify, by the exact recursion.

    Args:
        tree: The robot; only its geometry matters.
        model: "dynamic" for joint torques, "reaction" for the bedplate's wrench.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
        tared: The bedplate's static wrench in one posture has been taken off.
        known_zero: Barycentric parameters known to be zero, (n, 10); default none.
    """
    g = tree.gravity_or(gravity)
    static = _static(g) if model == "reaction" and not tared else np.zeros((0, 10))
    seen = [each.whole for each in seen_wrenches(tree, model, g, static)]
    return row_space(_on_barycentric(tree, seen, static), NEW, known_zero)


def seen_wrenches(tree: Tree, model: Model, gravity: Array, static: Array) -> Iterator[SeenWrench]:
    """What is identifiable of every composite body, from the bedplate outwards.

    Args:
        tree: The robot; only its geometry matters.
        model: "dynamic" for joint torques, "reaction" for the bedplate's wrench.
        gravity: (3,) [m/s^2], bedplate frame.
        static: Functionals of all that stands on the bedplate that are identifiable, (k, 10).
    """
    free: list[Array] = [np.eye(6) if model == "reaction" else np.zeros((0, 6))]  # index j + 1
    rest: list[Array] = [-np.concatenate([gravity, np.zeros(3)])]
    known: list[Array] = [static]
    for joint in tree.joints:
        screw, into, rate = _screw(joint), _twist_into(joint).T, _rate(joint)
        turning, momentum = _ad(screw).T, _momentum(screw)
        still = rest[joint.parent + 1] @ into
        ahead = _closed(np.vstack([free[joint.parent + 1] @ into, still @ turning]), turning)
        closure = _closed(known[joint.parent + 1] @ _composite_into(joint), rate)
        aside = _span(np.vstack([ahead @ momentum, closure @ rate]))
        here = SeenWrench(aside, screw @ momentum, still @ momentum)
        yield here
        free.append(_span(np.vstack([ahead, screw])))
        rest.append(still)
        known.append(_span(np.vstack([closure, here.whole])))


def _on_barycentric(tree: Tree, seen: list[Array], static: Array) -> Array:
    """Functionals of composites as functionals of the barycentric parameters, (k, 10 n)."""
    n = tree.n
    composite = np.zeros((n + 1, 10, 10 * n))  # at q = 0; the last is the bedplate's
    to_ours = _standard_from_barycentric(tree)
    rows: list[Array] = []
    for j in reversed(range(n)):
        composite[j] += to_ours[10 * j : 10 * j + 10]
        composite[tree.parents[j]] += _composite_into(tree.joints[j]) @ composite[j]
        rows.insert(0, seen[j] @ composite[j])
    rows.append(static @ composite[-1])
    return np.vstack(rows)


def _standard_from_barycentric(tree: Tree) -> Array:
    """(m, h, I) of every body, I in the order xx xy xz yy yz zz, from theta, (10 n, 10 n)."""
    theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
    in_our_order = [STANDARD.index(name) for name in ("m", "mx", "my", "mz", *_INERTIA)]
    standard: Array = to_standard(tree, theta)[:, in_our_order].reshape(10 * tree.n, -1)
    return standard


def _screw(joint: Joint) -> Array:
    """Unit twist of a joint in its own frame, linear part first, (6,)."""
    nothing = np.zeros(3)
    parts = (nothing, joint.axis) if joint.revolute else (joint.axis, nothing)
    return np.concatenate(parts)


def _ad(screw: Array) -> Array:
    """The operator ad of a twist on twists, linear part first, (6, 6)."""
    v, w = skew(screw[:3]), skew(screw[3:])
    return np.block([[w, v], [np.zeros((3, 3)), w]])


def _twist_into(joint: Joint) -> Array:
    """Twists of frame i seen in frame j at q = 0, (6, 6)."""
    back = joint.rotation.T
    return np.block([[back, -back @ skew(joint.offset)], [np.zeros((3, 3)), back]])


def _momentum(screw: Array) -> Array:
    """The six components of I_j S_j as functionals of (m, h, I), (6, 10)."""
    v, w = screw[:3], screw[3:]
    linear = np.concatenate([v[:, None], skew(w), np.zeros((3, 6))], axis=1)
    angular = np.concatenate(
        [np.zeros((3, 1)), -skew(v), np.einsum("abk,b->ak", TENSOR, w)], axis=1
    )
    return np.vstack([linear, angular])


def _composite_into(joint: Joint) -> Array:
    """(m, h, I) of composite j in frame i at q = 0, (10, 10)."""
    turn, l = joint.rotation, joint.offset
    moved = np.zeros((10, 10))
    moved[0, 0] = 1.0
    moved[1:4, 0], moved[1:4, 1:4] = l, turn
    moved[4:, 0] = (-skew(l) @ skew(l))[UPPER]
    for k in range(3):
        lever = skew(turn[:, k])
        moved[4:, 1 + k] = -(skew(l) @ lever + lever @ skew(l))[UPPER]
    for k in range(6):
        moved[4:, 4 + k] = (turn @ TENSOR[:, :, k] @ turn.T)[UPPER]
    return moved


def _rate(joint: Joint) -> Array:
    """d/dq at q = 0 of (m, h, I) of composite j, about the frame it is moved from, (10, 10)."""
    e = skew(joint.axis)
    rate = np.zeros((10, 10))
    if joint.revolute:
        rate[1:4, 1:4] = e
        for k in range(6):
            unit = TENSOR[:, :, k]
            rate[4:, 4 + k] = (e @ unit - unit @ e)[UPPER]
        return rate
    rate[1:4, 0] = joint.axis
    for k in range(3):
        lever = skew(np.eye(3)[k])
        rate[4:, 1 + k] = -(e @ lever + lever @ e)[UPPER]
    return rate


def _static(gravity: Array) -> Array:
    """The static wrench's functionals: mass, and two first moments normal to gravity."""
    if not gravity.any():
        return np.zeros((0, 10))
    rows = np.zeros((4, 10))
    rows[0, 0] = 1.0
    rows[1:, 1:4] = skew(gravity / np.linalg.norm(gravity))
    return _span(rows)


def _closed(rows: Array, operator: Array) -> Array:
    """The smallest space that holds `rows` and is mapped into itself by `operator`."""
    space = _span(rows)
    while True:
        larger = _span(np.vstack([space, space @ operator]))
        if len(larger) == len(space):
            return space
        space = larger


def _span(rows: Array) -> Array:
    """An orthonormal basis of the row space, (rank, columns).

    Rows are not rescaled: they are of order one, or rounding of zero, and rescaled
    rounding would count.
    """
    if not rows.any():
        return rows[:0]
    _, spread, directions = np.linalg.svd(rows, full_matrices=False)
    return directions[: int(np.sum(spread > NEW * max(1.0, spread[0])))]
