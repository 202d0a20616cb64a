"""Normal equations, channel by channel: all that a linear fit needs to know of the data.

Weights, subsets of channels and re-weighting are other sums of the same products: no
second look at the samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.kernel.layout import Layout
from testbed.core.kernel.records import Sums

ROUNDING = 1e-15
"""Least eigenvalue, of a matrix with a diagonal of ones, that is no rounding."""

TINY = float(np.finfo(float).tiny)
"""Least positive number: against division by zero."""


def scaled_solve(matrix: Array, right: Array) -> Array:
    """The solution of matrix x = right.

    Args:
        matrix: Symmetric and positive definite, (m, m).
        right: (m,) or (m, k).
    """
    root = inverse_root(matrix)
    return root @ (root.T @ right)


def scaled_inverse(matrix: Array) -> Array:
    """The inverse, symmetric and positive.

    Args:
        matrix: Symmetric and positive definite, (m, m).
    """
    root = inverse_root(matrix)
    return root @ root.T


def inverse_and_solution(matrix: Array, right: Array) -> tuple[Array, Array]:
    """The inverse, and the solution of matrix x = right.

    Args:
        matrix: Symmetric and positive definite, (m, m).
        right: (m,).
    """
    root = inverse_root(matrix)
    return root @ root.T, root @ (root.T @ right)


def standard_deviations(covariance: Array) -> Array:
    """Roots of the diagonal, (m,); zero where rounding leaves less.

    Args:
        covariance: (m, m).
    """
    return np.sqrt(np.maximum(np.diagonal(covariance), 0.0))


def unit_diagonal(matrix: Array) -> tuple[Array, Array]:
    """Matrix with a diagonal of ones, (m, m), and its scale, (m,); one for zeros.

    Args:
        matrix: Symmetric, (m, m).
    """
    diagonal = np.diagonal(matrix)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    return matrix / np.outer(scale, scale), scale


def square_root(matrix: Array) -> Array:
    """R with R R' the matrix, (m, m); of one that is singular but for rounding, nearly so.

    Args:
        matrix: Symmetric and positive, (m, m).
    """
    try:
        return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        scale = np.sqrt(np.maximum(np.diagonal(matrix), TINY))
        size, axes = eigh(matrix / np.outer(scale, scale))
        return scale[:, None] * axes * np.sqrt(np.maximum(size, ROUNDING))


def inverse_root(matrix: Array) -> Array:
    """R with R R' the inverse, (m, m): R' makes the matrix one of ones.

    Args:
        matrix: Symmetric and positive definite, (m, m).
    """
    factor = _clear_factor(matrix)
    if factor is None:
        return _inverse_root(matrix)
    inverse, _ = linalg.lapack.dtrtri(factor, lower=True)
    return np.asarray(inverse.T)


def _clear_factor(matrix: Array) -> Array | None:
    """Cholesky's factor, whose rounding does not depend on units; None if it is not clear."""
    factor, failed = linalg.lapack.dpotrf(matrix.T, lower=True, clean=True)
    own = factor.diagonal() ** 2
    # part of its length, squared, that every unknown has for itself beside those before it: then
    # Cholesky's factors serve, which are several times faster than eigenvalues
    return None if failed or (own <= 1e-6 * matrix.diagonal()).any() else factor


def _inverse_root(matrix: Array) -> Array:
    """By eigenvalues of the matrix with a diagonal of ones, where no factor is clear."""
    unit, scale = unit_diagonal(matrix)
    size, axes = eigh(unit)
    return np.asarray(axes / scale[:, None] / np.sqrt(np.maximum(size, ROUNDING)))


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Sums over rows of each channel; X are its columns, y its measurements.

    Attributes:
        unknowns: Names, (p,).
        channels: Names, (C,).
        used: Rows of each channel that count, (C,).
        normal: X' X, (C, p, p).
        right: X' y, (C, p).
        squares: y' y, (C,).
    """

    unknowns: tuple[str, ...]
    channels: tuple[str, ...]
    used: Array
    normal: Array
    right: Array
    squares: Array

    @property
    def rows(self) -> int:
        """Rows of all channels that count."""
        return int(self.used.sum())

    @property
    def rms(self) -> Array:
        """Of each channel's measurements over the rows that count, (C,)."""
        return np.sqrt(self.squares / np.maximum(self.used, 1.0))

    def of_channel(self, c: int) -> tuple[Array, Array, float]:
        """Of one channel alone: X' X, (p, p), X' y, (p,), and y' y."""
        return self.normal[c], self.right[c], float(self.squares[c])

    def of_unknowns(self, kept: Sequence[int]) -> NormalEquations:
        """The same without the other unknowns.

        Args:
            kept: Numbers of those that stay.
        """
        at = np.array(kept, dtype=np.int64)
        return replace(
            self,
            unknowns=tuple(self.unknowns[k] for k in kept),
            normal=self.normal[..., at[:, None], at],
            right=self.right[..., at],
        )

    def matrix(self, weights: Array) -> Array:
        """X' X of all channels, (p, p), by weights (C,)."""
        return np.tensordot(weights, self.normal, 1)

    def vector(self, weights: Array) -> Array:
        """X' y of all channels, (p,), by weights (C,)."""
        return np.asarray(weights @ self.right)

    def residual(self, values: Array) -> Array:
        """Squares of the channels' residuals, (C,), to 1e-8 of the measurement's square.

        Args:
            values: Of the unknowns, (p,).
        """
        squares = self.squares - 2 * self.right @ values + self.normal @ values @ values
        return np.maximum(squares, 0.0)


def gather(
    layout: Layout,
    unknowns: tuple[str, ...],
    channels: tuple[str, ...],
    windows: Iterable[Sums],
) -> NormalEquations:
    """Those of all rows from sums over windows, in their order.

    Args:
        layout: The rows.
        unknowns: Names of the columns of `layout.basis`.
        channels: Names.
        windows: Windows' answers.
    """
    used, raw = np.zeros(len(channels)), np.zeros(0)
    for sums in windows:
        used += sums.used
        raw = sums.products if raw.size == 0 else raw + sums.products
    rows, p = layout.rows, len(unknowns)
    products = np.empty((len(channels), p + 1, p + 1))
    for c, columns in enumerate(layout.channels):
        width, at = rows.width[c], rows.group_gram[c]
        lower = np.tril(raw[at : at + width**2].reshape(width, width))
        basis = np.zeros((width, p + 1))
        basis[: len(columns), :-1] = layout.basis[columns]
        basis[rows.measured[c] - rows.start[c], -1] = 1.0
        products[c] = basis.T @ (lower + np.tril(lower, -1).T) @ basis
    normal, right, squares = (
        products[:, :-1, :-1],
        products[:, :-1, -1],
        products[:, -1, -1],
    )
    return NormalEquations(unknowns, channels, used, normal, right, squares)
