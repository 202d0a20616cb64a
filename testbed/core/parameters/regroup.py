"""Leaf to base: parameters are added into the carrying body; formulas with a model's lengths."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array, skew
from testbed.core.base.transform import Transform
from testbed.core.parameters.pseudo_inertia import inertia_matrix, inertia_rate
from testbed.core.parameters.rules import (
    NOTHING_KEPT,
    Model,
    Row,
    base_rule,
    mobilities,
    rule,
    unit_twist,
)
from testbed.core.parameters.symbols import (
    STANDARD_ORDER,
    TENSOR,
    Formula,
    Label,
    Symbol,
    Term,
    component_symbol,
)
from testbed.core.robot.tree import Joint, Tree


def beyond(vector: Array, basis: Array) -> Array:
    """The part of a vector that orthonormal rows, (k, N), do not span."""
    for _ in range(2):  # twice is enough against rounding
        vector = vector - basis.T @ (basis @ vector)
    return vector


NEW = 1e-8
"""Part of a unit functional that must be left after projection for it to be a new one."""


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
        return span(np.vstack([self.aside, self.inertia, self.weight]))


def seen_wrenches(
    tree: Tree, model: Model, gravity: Array, static: Array
) -> Iterator[SeenWrench]:
    """What is identifiable of every composite body, from the bedplate outwards.

    Args:
        tree: The robot; only its geometry matters.
        model: "dynamic" for joint torques, "reaction" for the bedplate's wrench.
        gravity: (3,) [m/s^2], bedplate frame.
        static: Functionals of all that stands on the bedplate that are identifiable, (k, 10).
    """
    # index j + 1
    free: list[Array] = [np.eye(6) if model == "reaction" else np.zeros((0, 6))]
    rest: list[Array] = [-np.concatenate([gravity, np.zeros(3)])]
    known: list[Array] = [static]
    for j, joint in enumerate(tree.joints):
        screw, into = unit_twist(joint), joint.X_PB.wrench_matrix
        rate = _in_our_order(inertia_rate(screw))
        turning, momentum = _ad(screw).T, _momentum(screw)
        still = rest[joint.parent + 1] @ into
        ahead = _closed(
            np.vstack([free[joint.parent + 1] @ into, still @ turning]), turning
        )
        closure = _closed(known[joint.parent + 1] @ moved_inertia(joint.X_PB), rate)
        aside = span(np.vstack([ahead @ momentum, closure @ rate]))
        here = SeenWrench(aside, screw @ momentum, still @ momentum)
        yield here
        free.append(span(np.vstack([ahead, screw])))
        rest.append(still)
        if tree.sensor is None or j >= tree.lead:
            known.append(span(np.vstack([closure, here.whole])))
        else:
            known.append(static)


def base_functionals(tree: Tree, gravity: Array, *, tared: bool) -> Array:
    """What the wrench on a base identifies of its ten parameters, orthonormal, (k, 10).

    The wrench is I a + v x* I v, with the base's velocity v and its acceleration a, less gravity.
    Its second part is a combination of the six components of I v: what counts is in which
    directions the joints before the base can move it, and gravity can point in its frame.

    Args:
        tree: The robot; its first joints lead to the base.
        gravity: (3,) [m/s^2], bedplate frame.
        tared: The static wrench in one posture has been taken off.
    """
    twists, changes = np.zeros((0, 6)), np.zeros((0, 6))
    weight = -np.concatenate([gravity, np.zeros(3)])
    for joint in tree.joints[: tree.lead]:
        screw, into = unit_twist(joint), joint.X_PB.wrench_matrix
        turning = _ad(screw).T
        weight = weight @ into
        twists = span(np.vstack([_closed(twists @ into, turning), screw]))
        changes = _closed(np.vstack([changes @ into, weight @ turning]), turning)
    pulls = changes if tared else np.vstack([changes, weight])
    return span(np.vstack([_momentum(twist) for twist in (*twists, *span(pulls))]))


def _ad(screw: Array) -> Array:
    """The operator ad of a twist on twists, linear part first, (6, 6)."""
    v, w = skew(screw[:3]), skew(screw[3:])
    return np.block([[w, v], [np.zeros((3, 3)), w]])


def _momentum(screw: Array) -> Array:
    """The six components of I_j S_j as functionals of (m, h, I), (6, 10)."""
    v, w = screw[:3], screw[3:]
    linear = np.concatenate([v[:, None], skew(w), np.zeros((3, 6))], axis=1)
    angular = np.concatenate(
        [np.zeros((3, 1)), -skew(v), np.einsum("abk,b->ak", TENSOR, w)], axis=1
    )
    return np.vstack([linear, angular])


def moved_inertia(X_AB: Transform) -> Array:
    """Matrix that moves inertial parameters (m, h, I) from frame B to A, (..., 10, 10).

    Tensors in the order of UPPER [kg, kg m, kg m^2].

    Args:
        X_AB: Pose of frame B in A.
    """
    return _in_our_order(inertia_matrix(X_AB))


def _in_our_order(matrix: Array) -> Array:
    """Matrix on (m, h, I) of one on standard parameters, (..., 10, 10)."""
    return matrix[..., STANDARD_ORDER, :][..., STANDARD_ORDER]


def _closed(rows: Array, operator: Array) -> Array:
    """The smallest space that holds `rows` and is mapped into itself by `operator`."""
    space = span(rows)
    while True:
        larger = span(np.vstack([space, space @ operator]))
        if len(larger) == len(space):
            return space
        space = larger


def span(rows: Array) -> Array:
    """An orthonormal basis of the row space, (rank, columns).

    Rows are not rescaled: they are of order one, or rounding of zero, and rescaled
    rounding would count.
    """
    if not rows.any():
        return rows[:0]
    _, spread, directions = np.linalg.svd(rows, full_matrices=False)
    return directions[: int(np.sum(spread > NEW * max(1.0, spread[0])))]


@dataclass(frozen=True, eq=False)
class Body:
    """One body after regrouping.

    Attributes:
        row: What stays with it.
        passing: What it passes to its carrier, per unit and per component of the offset:
            (4, 10, 10), carrier's ten from own ten, for (1, lx, ly, lz).
        gain: The same with the model's offset, (10, 10).
    """

    row: Row
    passing: Array
    gain: Array


def regroup(
    tree: Tree, model: Model, gravity: Array, *, tared: bool = False
) -> tuple[Body, ...]:
    """Apply the rules to every joint.

    Args:
        tree: The robot.
        model: "dynamic" for joint torques, "reaction" for the bedplate's wrench.
        gravity: In the bedplate frame, (3,) [m/s^2].
        tared: The static wrench in one posture has been taken off.
    """
    bodies = []
    for j, (joint, ahead) in enumerate(
        zip(tree.joints, mobilities(tree, gravity), strict=True)
    ):
        if j < tree.massless:
            row = NOTHING_KEPT
        elif j == tree.lead - 1:
            row = base_rule(base_functionals(tree, gravity, tared=tared))
        else:
            row = rule(joint, ahead, model)
        passing = migration(joint, row)
        gain = np.tensordot(np.concatenate([[1.0], joint.offset]), passing, 1)
        bodies.append(Body(row, passing, gain))
    return tuple(bodies)


def redefined_parameters(tree: Tree, bodies: Sequence[Body]) -> Array:
    """The redefined parameters of every body on the barycentric ones, (n, 10, 10 n).

    From the tips to the base; dense, so its size grows with the square of the number of
    bodies.
    """
    redefined = np.zeros((tree.n, 10, 10 * tree.n))
    for j in reversed(range(tree.n)):
        redefined[j, range(10), range(10 * j, 10 * j + 10)] += 1.0
        if tree.parents[j] >= 0:
            redefined[tree.parents[j]] += bodies[j].gain @ redefined[j]
    return redefined


def migration(joint: Joint, row: Row) -> Array:
    """What body i gains from the ten redefined parameters of body j, (4, 10, 10).

    With b the migrating part of mb^j in frame i: mb*^i = mb^i + b and
    K*^i = K^i + (migrating part of K^j) - (l~ b~ + b~ l~), where
    l~ b~ + b~ l~ = b l' + l b' - 2 (l . b) 1.
    """
    # affine in the offset: at none, and along each axis
    X_AB = Transform(np.broadcast_to(joint.rotation, (4, 3, 3)), np.eye(4)[:, 1:])
    gains = moved_inertia(X_AB) @ row.passed
    gains[1:] -= gains[0]
    gains[np.abs(gains) < 1e-15] = 0.0
    return gains


NEGLIGIBLE = 1e-12
"""Coefficients below this are not printed: rounding of zero, an axis turned by a quarter."""

Lengths = Literal["symbols", "numbers"]


@dataclass(frozen=True, eq=False)
class Namer:
    """Formulas of the redefined parameters of a regrouped tree.

    Attributes:
        tree: The robot.
        bodies: Its bodies after regrouping.
        known_zero: Which of the barycentric parameters are known to be zero, (n, 10).
        lengths: Whether offsets are printed as symbols or as numbers.
    """

    tree: Tree
    bodies: Sequence[Body]
    known_zero: NDArray[np.bool_]
    lengths: Lengths = "symbols"

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """Which of the redefined parameters are not zero, (n, 10)."""
        present = ~self.known_zero
        for j in reversed(range(self.tree.n)):
            if self.tree.parents[j] >= 0:
                gained = (self.bodies[j].gain[:, present[j]] != 0).any(axis=1)
                present[self.tree.parents[j]] |= gained
        return present

    def component(self, body: int, component: int) -> Symbol:
        """One of the ten redefined parameters of a body."""
        return component_symbol(body, component, star=bool(self.tree.children(body)))

    def redefinition(self, body: int, component: int) -> Formula:
        """The formula of one of the ten redefined parameters of a body."""
        left = Label((Term(self.component(body, component)),))
        return self.formula(left, body, np.eye(10)[component])

    def formula(self, left: Label, body: int, form: Array) -> Formula:
        """`left` = the form of body `body`: own parameters and what its children pass on.

        Body -1 is the bedplate, whose own parameters do not count; of its children's
        masses it holds the sum and, at their offsets, the first moment.
        """
        terms: list[Term] = []
        if body >= 0:
            for c in np.flatnonzero(np.abs(form) > NEGLIGIBLE):
                if not self.known_zero[body, c]:
                    weight = ((float(form[c]), None),)
                    terms.append(Term(component_symbol(body, int(c)), weight))
        for child in self.tree.children(body):
            weights = np.tensordot(form, self.bodies[child].passing, (0, 1))  # (4, 10)
            if body < 0:
                weights[0, 0] += form[0]
                weights[1:, 0] += form[1:4]
            for c in np.flatnonzero(np.abs(weights).max(axis=0) > NEGLIGIBLE):
                factor = self._factor(weights[:, c], body, child)
                if factor and self.present[child, c]:
                    terms.append(Term(self.component(child, int(c)), factor))
        return Formula(left, tuple(terms))

    def _factor(
        self, weights: Array, body: int, child: int
    ) -> tuple[tuple[float, Symbol | None], ...]:
        """The weights of 1, lx, ly, lz with their lengths; () if they vanish with these."""
        offset = self.tree.joints[child].offset
        if self.lengths == "numbers":
            value = float(weights[0] + weights[1:] @ offset)
            return ((value, None),) if abs(value) > NEGLIGIBLE else ()
        factor: list[tuple[float, Symbol | None]] = []
        if abs(weights[0]) > NEGLIGIBLE:
            factor.append((float(weights[0]), None))
        for weight, axis, length in zip(weights[1:], "xyz", offset, strict=True):
            if min(abs(weight), abs(length)) > NEGLIGIBLE:
                factor.append((float(weight), length_symbol(body, child, axis)))
        return tuple(factor)


def length_symbol(body: int, child: int, axis: str) -> Symbol:
    """A component of the offset from a body to one it carries: l23z, l9_10z.

    Args:
        body: Index of the carrying body, -1 for the bedplate.
        child: Index of the body it carries.
        axis: "x", "y" or "z" of the carrying body.
    """
    return Symbol("l", (body + 1, child + 1), axis)
