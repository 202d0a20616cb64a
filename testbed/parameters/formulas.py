"""Regrouping formulas with the model's own lengths: K*1yz = K1yz - l12z*mb*2y.

One level at a time: a starred parameter on the right has a formula of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.parameters.barycentric import component_symbol
from testbed.parameters.regroup import Body
from testbed.parameters.symbols import Formula, Label, Symbol, Term
from testbed.robot.tree import Tree

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
