"""Normal equations, channel by channel: sums of products for linear least squares.

Fits with other weights or subsets of channels use other sums of the same products and need no
further pass over the samples.
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

MIN_EIGENVALUE = 1e-15
"""Smallest eigenvalue of a matrix with unit diagonal that is not rounding."""

SMALLEST_POSITIVE = float(np.finfo(float).tiny)
"""Smallest positive number, against division by zero."""


def solve_scaled(matrix: Array, right: Array) -> Array:
    """Solution of matrix x = right, with the matrix scaled to unit diagonal.

    Args:
        matrix: Symmetric positive definite matrix, (m, m).
        right: Right-hand side, (m,) or (m, k).
    """
    root = inverse_square_root(matrix)
    return root @ (root.T @ right)


def scaled_inverse(matrix: Array) -> Array:
    """Inverse of a symmetric positive definite matrix, from its inverse square root.

    Args:
        matrix: Symmetric positive definite matrix, (m, m).
    """
    root = inverse_square_root(matrix)
    return root @ root.T


def inverse_and_solution(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Inverse of a matrix, and the solution of matrix x = right.

    Args:
        matrix: Symmetric positive definite matrix, (m, m).
        right: Right-hand side, (m,).
    """
    root = inverse_square_root(matrix)
    return root @ root.T, root @ (root.T @ right)


def standard_deviations(covariance: Array) -> Array:
    """Square roots of a covariance's diagonal, (m,); zero for negative elements.

    Args:
        covariance: Covariance, (m, m).
    """
    return np.sqrt(np.maximum(np.diagonal(covariance), 0.0))


def unit_diagonal(matrix: Array) -> tuple[Array, Array]:
    """Matrix scaled to unit diagonal, (m, m), and square roots of its diagonal, (m,).

    The scale of zero diagonal elements is one.

    Args:
        matrix: Symmetric matrix, (m, m).
    """
    diagonal = np.diagonal(matrix)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    return matrix / np.outer(scale, scale), scale


def matrix_square_root(matrix: Array) -> Array:
    """Square root R of a matrix R R' from Cholesky factorisation, (m, m).

    For a singular matrix, R is computed from the eigenvalues of the matrix scaled to unit diagonal,
    raised to at least MIN_EIGENVALUE.

    Args:
        matrix: Symmetric positive semidefinite matrix, (m, m).
    """
    try:
        return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        scale = np.sqrt(np.maximum(np.diagonal(matrix), SMALLEST_POSITIVE))
        eigenvalues, eigenvectors = eigh(matrix / np.outer(scale, scale))
        return (
            scale[:, None]
            * eigenvectors
            * np.sqrt(np.maximum(eigenvalues, MIN_EIGENVALUE))
        )


def inverse_square_root(matrix: Array) -> Array:
    """Square root R of the inverse R R' of a matrix, (m, m).

    R is the transposed inverse of the Cholesky factor. For an ill-conditioned matrix, R is computed
    from eigenvalues.

    Args:
        matrix: Symmetric positive definite matrix, (m, m).
    """
    factor = _well_conditioned_factor(matrix)
    if factor is None:
        return _inverse_root_by_eigenvalues(matrix)
    inverse, _ = linalg.lapack.dtrtri(factor, lower=True)
    return np.asarray(inverse.T)


def _well_conditioned_factor(matrix: Array) -> Array | None:
    """Lower Cholesky factor, (m, m); None for an ill-conditioned matrix.

    A matrix is ill-conditioned if it has no factor or if a squared pivot is at most 1e-6 of the
    diagonal element. The rounding errors of the factor, unlike those of eigenvalues, do not depend
    on units.
    """
    factor, failed = linalg.lapack.dpotrf(matrix.T, lower=True, clean=True)
    remainder = factor.diagonal() ** 2
    # smallest squared part of a column that is independent of the columns before, for Cholesky's
    # factor to be accurate; it is several times faster than eigenvalues
    return None if failed or (remainder <= 1e-6 * matrix.diagonal()).any() else factor


def _inverse_root_by_eigenvalues(matrix: Array) -> Array:
    """Square root R of the inverse R R' of an ill-conditioned matrix, (m, m).

    R is computed from the eigenvalues of the matrix scaled to unit diagonal, raised to at least
    MIN_EIGENVALUE.
    """
    unit, scale = unit_diagonal(matrix)
    eigenvalues, eigenvectors = eigh(unit)
    return np.asarray(
        eigenvectors / scale[:, None] / np.sqrt(np.maximum(eigenvalues, MIN_EIGENVALUE))
    )


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of each channel, with regressor columns X and measurements y.

    Attributes:
        unknowns: Names of the unknowns, (p,).
        channels: Names of the channels, (C,).
        used: Number of rows used in each channel, (C,).
        normal: X' X of each channel, (C, p, p).
        right: X' y of each channel, (C, p).
        squares: y' y of each channel, (C,).
    """

    unknowns: tuple[str, ...]
    channels: tuple[str, ...]
    used: Array
    normal: Array
    right: Array
    squares: Array

    @property
    def rows(self) -> int:
        """Number of rows used in all channels."""
        return int(self.used.sum())

    @property
    def rms(self) -> Array:
        """Rms of each channel's measurements over the rows used, (C,)."""
        return np.sqrt(self.squares / np.maximum(self.used, 1.0))

    def of_channel(self, c: int) -> tuple[Array, Array, float]:
        """Products X' X, (p, p), X' y, (p,), and y' y of channel c."""
        return self.normal[c], self.right[c], float(self.squares[c])

    def of_unknowns(self, indices: Sequence[int]) -> NormalEquations:
        """Normal equations of a subset of the unknowns, with the other columns omitted.

        Args:
            indices: Indices of the unknowns of the subset.
        """
        at = np.array(indices, dtype=np.int64)
        return replace(
            self,
            unknowns=tuple(self.unknowns[k] for k in indices),
            normal=self.normal[..., at[:, None], at],
            right=self.right[..., at],
        )

    def matrix(self, weights: Array) -> Array:
        """Weighted sum of X' X over the channels, (p, p), for weights (C,)."""
        return np.tensordot(weights, self.normal, 1)

    def vector(self, weights: Array) -> Array:
        """Weighted sum of X' y over the channels, (p,), for weights (C,)."""
        return np.asarray(weights @ self.right)

    def residual(self, values: Array) -> Array:
        """Sum of squared residuals of each channel, (C,).

        It is accurate to about 1e-8 of the sum of squared measurements.

        Args:
            values: Values of the unknowns, (p,).
        """
        squares = self.squares - 2 * self.right @ values + self.normal @ values @ values
        return np.maximum(squares, 0.0)


def assemble_normal_equations(
    layout: Layout,
    unknowns: tuple[str, ...],
    channels: tuple[str, ...],
    windows: Iterable[Sums],
) -> NormalEquations:
    """Assemble normal equations from the kernel's sums over windows.

    Args:
        layout: Layout of the rows.
        unknowns: Names of the columns of `layout.basis`.
        channels: Names of the channels.
        windows: Sums of the windows, in order.
    """
    used, raw = np.zeros(len(channels)), np.zeros(0)
    for sums in windows:
        used += sums.row_counts
        raw = sums.products if raw.size == 0 else raw + sums.products
    rows, p = layout.rows, len(unknowns)
    products = np.empty((len(channels), p + 1, p + 1))
    for c, columns in enumerate(layout.channel_columns):
        width, start = rows.width[c], rows.group_gram[c]
        lower = np.tril(raw[start : start + width**2].reshape(width, width))
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
