"""What all solvers give, and how they refuse."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NoReturn, Protocol

from testbed.arrays import Array
from testbed.errors import UnseenParameters
from testbed.identification.regression.normal_equations import NormalEquations

Rows = Callable[[Array], Iterator[tuple[Array, Array]]]
"""Starts a pass over all rows, with columns combined by a matrix, (p, q): blocks of combined
columns, (C, k, q), and of measurements, (C, k)."""

_PART = 0.1  # an unknown with a larger part in a direction that the data miss is named


@dataclass(frozen=True, eq=False)
class Fit:
    """A weighted least-squares solution.

    Attributes:
        values: (p,); nan for what no weighted channel sees.
        inverse: Inverse of X' W X, (p, p); nan likewise.
        weights: W, (C, C).
        condition: Of the weighted equations with columns of unit length.
        correctable: Whether one correction by the rows' own residuals makes it better.
    """

    values: Array
    inverse: Array
    weights: Array
    condition: float
    correctable: bool


class Solver(Protocol):
    """A way to solve weighted least squares."""

    def __call__(self, equations: NormalEquations, weights: Array, rows: Rows) -> Fit:
        """The solution.

        Args:
            equations: Of all rows.
            weights: W, (C, C).
            rows: For solvers that look at the rows themselves.

        Raises:
            UnseenParameters: The equations do not determine the unknowns; names them.
        """


def refuse(names: tuple[str, ...], directions: Array, rows: int) -> NoReturn:
    """Raise with the names of the unknowns that have a part in directions, (k, p), unseen."""
    parts = abs(directions).max(axis=0)
    unseen = [name for name, part in zip(names, parts, strict=True) if part > _PART]
    raise UnseenParameters(unseen, len(names) - len(directions), len(names), rows)
