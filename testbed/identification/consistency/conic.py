"""Conic programs: the one place that calls the solver.

Source    P. Goulart, Y. Chen, Clarabel: an interior-point solver for conic programs with quadratic
          objectives (2024)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import clarabel
import numpy as np
from scipy import sparse

from testbed.arrays import Array

Kind = Literal["zero", "positive", "norm", "matrices"]


@dataclass(frozen=True, eq=False)
class Cone:
    """Rows of a program: right - rows x lies in a cone.

    Attributes:
        kind: "zero", numbers that are zero; "positive", that are not negative; "norm", the first
            is at least the norm of the others; "matrices", coordinates of positive semidefinite
            4 x 4 matrices one after the other (`pseudo_inertia.coordinates`).
        rows: (k, m), dense or sparse.
        right: (k,).
    """

    kind: Kind
    rows: Array | sparse.sparray
    right: Array


@dataclass(frozen=True, eq=False)
class Solution:
    """Of a program.

    Attributes:
        solved: Whether there is one.
        x: Where, (m,).
        value: There.
        bound: A value that no other point goes below: of the dual program.
        prices: How much the value gains when a row's right side does, or, where there is no
            solution, the combination of rows that proves it, cone by cone.
    """

    solved: bool
    x: Array
    value: float
    bound: float
    prices: tuple[Array, ...]


def minimise(costs: Array, cones: Sequence[Cone]) -> Solution:
    """The least costs' x with all rows in their cones.

    Args:
        costs: (m,).
        cones: At least one.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    found = clarabel.DefaultSolver(
        sparse.csc_matrix((len(costs), len(costs))),  # no quadratic part
        costs,
        sparse.csc_matrix(sparse.vstack([sparse.csc_matrix(cone.rows) for cone in cones])),
        np.concatenate([cone.right for cone in cones]),
        [part for cone in cones for part in _parts(cone)],
        settings,
    ).solve()
    ends = np.cumsum([len(cone.right) for cone in cones])[:-1]
    solved = str(found.status) in ("Solved", "AlmostSolved")
    prices = tuple(np.split(np.array(found.z), ends))
    return Solution(
        solved, np.array(found.x), float(found.obj_val), float(found.obj_val_dual), prices
    )


def _parts(cone: Cone) -> list[object]:
    """A cone as the solver has it."""
    count = len(cone.right)
    if cone.kind == "matrices":
        return [clarabel.PSDTriangleConeT(4)] * (count // 10)
    kinds = {
        "zero": clarabel.ZeroConeT,
        "positive": clarabel.NonnegativeConeT,
        "norm": clarabel.SecondOrderConeT,
    }
    return [kinds[cone.kind](count)] if count else []
