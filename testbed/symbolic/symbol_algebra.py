"""The algebra of expressions, with which the recursions of `dynamics` run on symbols.

Names     w3x, W3xy, F3x of body 3; of many columns F3x_7; S223 = sin(2 q2 + q3)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from testbed.arrays import AnyArray
from testbed.symbolic.budget import Budget
from testbed.symbolic.expression import Expression, Factor, Nature, of


class Symbols:
    """The algebra of expressions, for the recursions of `dynamics`."""

    def __init__(self, budget: Budget, mark: str = "") -> None:
        """An algebra.

        Args:
            budget: Counts the terms of auxiliary variables.
            mark: Put behind the names of auxiliary variables.
        """
        self._budget = budget
        self._mark = mark

    def sin(self, angle: AnyArray) -> AnyArray:
        """Sine of every angle."""
        return _each(angle, sine)

    def cos(self, angle: AnyArray) -> AnyArray:
        """Cosine of every angle."""
        return _each(angle, cosine)

    def keep(self, name: str, value: AnyArray) -> AnyArray:
        """Auxiliary variables for all components that take an operation to compute."""
        kept = np.empty(value.shape, dtype=object)
        for place in np.ndindex(value.shape):
            one = value.item(place)
            kept[place] = auxiliary(component(name, place, value.shape) + self._mark, one)
            if isinstance(one, Expression):
                self._budget.write(len(one.terms))
        return kept


def component(name: str, place: tuple[int, ...], shape: tuple[int, ...]) -> str:
    """Name of one component: ("w3", (0,)) gives w3x, of a matrix W3xy, of many columns F3x_7."""
    if len(shape) == 1 or name.startswith("W"):
        return name + "".join("xyz"[index] for index in place)
    return name + "xyz"[place[0]] + (f"_{place[1] + 1}" if shape[1] > 1 else "")


def auxiliary(name: str, value: Any) -> Any:
    """`value` under a name, unless it is a number, a single factor, or the same for all samples.

    Products of parameters and lengths without a name can cancel.
    """
    if not isinstance(value, Expression) or len(value.terms) < 1:
        return value
    factors, size = value.terms[0]
    if len(value.terms) == 1:
        fixed = all(f.nature in (Nature.PARAMETER, Nature.CONSTANT) for f in factors)
        if fixed or (len(factors) <= 1 and abs(size) == 1):
            return value
    return of(Factor(Nature.AUXILIARY, name, value))


def sine(angle: Expression) -> Expression:
    """Sine of an expression, odd."""
    if angle.terms[0][1] < 0:
        return -sine(-angle)
    return of(Factor(Nature.SINE, _trig("S", angle), angle))


def cosine(angle: Expression) -> Expression:
    """Cosine of an expression, even."""
    if angle.terms[0][1] < 0:
        angle = -angle
    return of(Factor(Nature.COSINE, _trig("C", angle), angle))


def _trig(letter: str, angle: Expression) -> str:
    """S223 of 2*q2 + q3; S_2_m3 of q2 - q3, S_12 of q12."""
    labels = []
    for factors, size in angle.terms:
        label = "".join(factor.name for factor in factors).removeprefix("q")
        labels += ["m" * (size < 0) + label] * int(abs(size))
    if all(len(label) == 1 for label in labels):
        return letter + "".join(labels)
    return f"{letter}_{'_'.join(labels)}"


def _each(angle: AnyArray, function: Callable[[Expression], Expression]) -> AnyArray:
    made = np.empty(np.shape(angle), dtype=object)
    for place in np.ndindex(made.shape):
        made[place] = function(angle.item(place))
    return made
