"""Leaf to base: parameters are added into the carrying body; formulas with a model's lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.parameters.barycentric import TENSOR, UPPER, component_symbol
from testbed.parameters.rules import Model, Row, base_rule, mobilities, rule
from testbed.parameters.symbols import Formula, Label, Symbol, Term
from testbed.robot.free_base import FREE
from testbed.robot.tree import Joint, Tree

_UPPER = tuple(zip(*UPPER, strict=True))


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


def regroup(tree: Tree, model: Model, gravity: Array) -> tuple[Body, ...]:
    """Apply the rules to every joint.

    Args:
        tree: The robot.
        model: "dynamic" for joint torques, "reaction" for the bedplate's wrench.
        gravity: In the bedplate frame, (3,) [m/s^2].
    """
    bodies = []
    for j, (joint, ahead) in enumerate(zip(tree.joints, mobilities(tree, gravity), strict=True)):
        of_base = tree.floating and j < FREE
        row = base_rule(is_base=j == FREE - 1) if of_base else rule(joint, ahead, model)
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
    if row.tensor == "none":
        return np.zeros((4, 10, 10))
    turn = joint.rotation
    b = turn @ row.passed  # (3, 3): b = this times mb^j
    gains = np.zeros((4, 10, 10))
    gains[0, 1:4, 1:4] = b
    if row.tensor == "all":
        tensor = np.einsum("ac,cdk,bd->abk", turn, TENSOR, turn)
    else:
        e = joint.carried_axis
        mean = (
            np.einsum("aak->k", TENSOR) - np.einsum("a,abk,b->k", joint.axis, TENSOR, joint.axis)
        ) / 2
        tensor = np.multiply.outer(np.eye(3) - np.outer(e, e), mean)
    gains[0, 4:, 4:] = [tensor[a, c] for a, c in _UPPER]
    for x in range(3):  # offset along axis x
        l = np.eye(3)[x]
        moved = (
            2 * np.multiply.outer(np.eye(3), b[x])
            - np.einsum("ak,b->abk", b, l)
            - np.einsum("a,bk->abk", l, b)
        )
        gains[1 + x, 4:, 1:4] = [moved[a, c] for a, c in _UPPER]
    gains[np.abs(gains) < 1e-15] = 0.0
    return gains


ROUNDING = 1e-12
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
            for c in np.flatnonzero(np.abs(form) > ROUNDING):
                if not self.known_zero[body, c]:
                    weight = ((float(form[c]), None),)
                    terms.append(Term(component_symbol(body, int(c)), weight))
        for child in self.tree.children(body):
            weights = np.tensordot(form, self.bodies[child].passing, (0, 1))  # (4, 10)
            if body < 0:
                weights[0, 0] += form[0]
                weights[1:, 0] += form[1:4]
            for c in np.flatnonzero(np.abs(weights).max(axis=0) > ROUNDING):
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
            return ((value, None),) if abs(value) > ROUNDING else ()
        factor: list[tuple[float, Symbol | None]] = []
        if abs(weights[0]) > ROUNDING:
            factor.append((float(weights[0]), None))
        for weight, axis, length in zip(weights[1:], "xyz", offset, strict=True):
            if min(abs(weight), abs(length)) > ROUNDING:
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
