"""Row spaces: what a measurement can identify, whatever the parameters are called."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array

ROUNDING = 1e-13
"""Part of all rows that is rounding of zero, whatever is left of them."""


@dataclass(frozen=True, eq=False)
class Space:
    """A row space of functionals on the 10 n barycentric parameters.

    Attributes:
        rows: (rank, 10 n), orthonormal.
        gap: Ratio of the smallest singular value kept to the largest one dropped: how
            clear the decision on the rank was.
    """

    rows: Array
    gap: float

    @property
    def rank(self) -> int:
        """Number of functionals."""
        return len(self.rows)


def row_space(rows: Array, tolerance: float, known_zero: NDArray[np.bool_] | None = None) -> Space:
    """The space spanned by rows, (k, 10 n).

    Args:
        rows: Of any sizes; rows are not rescaled, so rounding of zero stays small.
        tolerance: Singular values below this share of the largest count as zero.
        known_zero: Parameters known to be zero, (n, 10), whose columns do not count;
            default none.
    """
    rounding = ROUNDING * float(np.linalg.norm(rows))
    if known_zero is not None:
        rows = np.where(known_zero.ravel(), 0.0, rows)
    if not rows.any():
        return Space(np.zeros((0, rows.shape[1])), np.inf)
    _, spread, directions = np.linalg.svd(rows, full_matrices=False)
    rank = int(np.sum(spread > max(tolerance * spread[0], rounding)))
    if rank == 0:
        return Space(directions[:0], np.inf)
    dropped = spread[rank] if rank < len(spread) else 0.0
    return Space(directions[:rank], float(spread[rank - 1] / max(dropped, 1e-300)))


def beyond(vector: Array, basis: Array) -> Array:
    """The part of a vector that orthonormal rows, (k, N), do not span."""
    for _ in range(2):  # twice is enough against rounding
        vector = vector - basis.T @ (basis @ vector)
    return vector


def distance(a: Space, b: Space) -> float:
    """Sine of the largest angle between two row spaces of one rank; 1 if the ranks differ."""
    if a.rank != b.rank:
        return 1.0
    if a.rank == 0:
        return 0.0
    return float(np.linalg.norm(a.rows - (a.rows @ b.rows.T) @ b.rows, 2))
