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

CLEAR = 1e-6
"""Part of its length, squared, that every unknown has for itself beside those before it: then
Cholesky's factors serve, which are several times faster than eigenvalues."""


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
    factor = _clear_factor(matrix)
    if factor is None:
        root = _inverse_root(matrix)
        return root @ root.T, root @ (root.T @ right)
    solution, _ = linalg.lapack.dpotrs(factor, right, lower=True)
    lower, _ = linalg.lapack.dpotri(factor, lower=True)
    inverse = lower + lower.T
    np.einsum("ii->i", inverse)[:] = lower.diagonal()
    return inverse, solution


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
    return None if failed or (own <= CLEAR * matrix.diagonal()).any() else factor


def _inverse_root(matrix: Array) -> Array:
    """By eigenvalues of the matrix with a diagonal of ones, where no factor is clear."""
    diagonal = np.diagonal(matrix)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    size, axes = eigh(matrix * np.outer(scale, scale))
    return scale[:, None] * axes / np.sqrt(np.maximum(size, ROUNDING))


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Sums over rows, for channels c and d; X are columns, y measurements.

    Attributes:
        unknowns: Names, (p,).
        channels: Names, (C,).
        used: Rows of each channel that count, (C,).
        normal: X_c' X_d, (C, C, p, p); or, where sums across channels were not taken,
            X_c' X_c, (C, p, p).
        right: X_c' y_d, (C, C, p); or X_c' y_c, (C, p).
        square: y_c' y_d, (C, C); or y_c' y_c, (C,).
    """

    unknowns: tuple[str, ...]
    channels: tuple[str, ...]
    used: Array
    normal: Array
    right: Array
    square: Array

    @property
    def joined(self) -> bool:
        """Whether sums across channels are there."""
        return self.square.ndim == 2

    @property
    def rows(self) -> int:
        """Rows of all channels that count."""
        return int(self.used.sum())

    @property
    def squares(self) -> Array:
        """Sum of the squares of each channel's measurements, (C,)."""
        return np.diagonal(self.square) if self.joined else self.square

    @property
    def rms(self) -> Array:
        """Of each channel's measurements over the rows that count, (C,)."""
        return np.sqrt(self.squares / np.maximum(self.used, 1.0))

    def of_channel(self, c: int) -> tuple[Array, Array, float]:
        """Of one channel alone: X' X, (p, p), X' y, (p,), and y' y."""
        at = (c, c) if self.joined else (c,)
        return self.normal[at], self.right[at], float(self.square[at])

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
        """X' W X, (p, p).

        Args:
            weights: W, (C, C); diagonal unless the equations are joined.
        """
        if self.joined:
            return np.asarray(np.einsum("cd,cdij->ij", weights, self.normal))
        return np.tensordot(np.diagonal(weights), self.normal, 1)

    def vector(self, weights: Array) -> Array:
        """X' W y, (p,).

        Args:
            weights: W, (C, C); diagonal unless the equations are joined.
        """
        if self.joined:
            return np.asarray(np.einsum("cd,cdi->i", weights, self.right))
        return np.diagonal(weights) @ self.right

    def residual(self, values: Array) -> Array:
        """Products of the channels' residuals, (C, C), to 1e-8 of the measurement's square.

        Args:
            values: Of the unknowns, (p,).
        """
        if not self.joined:
            found = self.square - 2 * self.right @ values + self.normal @ values @ values
            return np.diag(np.maximum(found, 0.0))
        mixed = self.right @ values
        return self.square - mixed - mixed.T + self.normal @ values @ values


def gather(
    layout: Layout, unknowns: tuple[str, ...], channels: tuple[str, ...], found: Iterable[Sums]
) -> NormalEquations:
    """Those of all rows from sums over windows, in their order.

    Args:
        layout: The rows.
        unknowns: Names of the columns of `layout.basis`.
        channels: Names.
        found: Windows' answers.
    """
    used, raw = np.zeros(len(channels)), np.zeros(0)
    for sums in found:
        used += sums.used
        raw = sums.products if raw.size == 0 else raw + sums.products
    rows, basis = layout.rows, layout.basis
    joined = len(rows.group_slot) < len(channels)
    blocks = []
    for width, at in zip(rows.group_width, rows.group_gram, strict=True):
        block = np.tril(raw[at : at + width**2].reshape(width, width))
        blocks.append(block + np.tril(block, -1).T)

    def cut(c: int, d: int) -> tuple[Array, Array, float]:
        """The block of two channels, on the unknowns."""
        block = blocks[0 if joined else c]
        origin = 0 if joined else rows.start[c]
        lines, ranks = (rows.start[k] - origin + np.arange(len(layout.channels[k])) for k in (c, d))
        y, x = rows.measured[c] - origin, rows.measured[d] - origin
        left, right = basis[layout.channels[c]], basis[layout.channels[d]]
        inner = left.T @ block[np.ix_(lines, ranks)] @ right
        return inner, left.T @ block[lines, x], float(block[y, x])

    size = range(len(channels))
    parts = [[cut(c, d) for d in (size if joined else (c,))] for c in size]
    arrays = [np.array([[part[k] for part in line] for line in parts]) for k in range(3)]
    normal, right, square = arrays if joined else [array[:, 0] for array in arrays]
    return NormalEquations(unknowns, channels, used, normal, right, square)
