"""Symmetric equations with unknowns of different units: solved with a diagonal of ones.

Whitening by noise without end takes constants away, and with them what distinguishes unknowns.
Directions that only rounding determines are then held, and their variance is large: never negative.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from testbed.arrays import Array
from testbed.blas import eigh

ROUNDING = 1e-15
"""Least eigenvalue, of a matrix with a diagonal of ones, that is no rounding."""

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
    return np.asarray(root @ (root.T @ right))


def scaled_inverse(matrix: Array) -> Array:
    """The inverse, symmetric and positive.

    Args:
        matrix: Symmetric and positive definite, (m, m).
    """
    root = inverse_root(matrix)
    return np.asarray(root @ root.T)


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
    np.fill_diagonal(inverse, np.diagonal(lower))
    return inverse, solution


def square_root(matrix: Array) -> Array:
    """R with R R' the matrix, (m, m); of one that is singular but for rounding, nearly so.

    Args:
        matrix: Symmetric and positive, (m, m).
    """
    try:
        return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        scale = np.sqrt(np.maximum(np.diagonal(matrix), np.finfo(float).tiny))
        size, axes = eigh(matrix / np.outer(scale, scale))
        return np.asarray(scale[:, None] * axes * np.sqrt(np.maximum(size, ROUNDING)))


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
    own = np.diagonal(factor) ** 2
    return None if failed or (own <= CLEAR * np.diagonal(matrix)).any() else factor


def _inverse_root(matrix: Array) -> Array:
    """By eigenvalues of the matrix with a diagonal of ones, where no factor is clear."""
    diagonal = np.diagonal(matrix)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    size, axes = eigh(matrix * np.outer(scale, scale))
    return np.asarray(scale[:, None] * axes / np.sqrt(np.maximum(size, ROUNDING)))
