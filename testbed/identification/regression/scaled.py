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
    unit, scale, factor = _factor(matrix)
    if factor is None:
        root = _inverse_root(unit, scale)
        return root @ root.T, root @ (root.T @ right)
    solution, _ = linalg.lapack.dpotrs(factor, scale * right, lower=True)
    lower, _ = linalg.lapack.dpotri(factor, lower=True)
    inverse = lower + lower.T
    np.fill_diagonal(inverse, np.diagonal(lower))
    return inverse * np.outer(scale, scale), scale * solution


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
    unit, scale, factor = _factor(matrix)
    if factor is None:
        return _inverse_root(unit, scale)
    inverse, _ = linalg.lapack.dtrtri(factor, lower=True)
    return np.asarray(scale[:, None] * inverse.T)


def _factor(matrix: Array) -> tuple[Array, Array, Array | None]:
    """The matrix with a diagonal of ones, what makes it so, and its Cholesky factor if clear."""
    diagonal = np.diagonal(matrix)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    unit = matrix * np.outer(scale, scale)
    factor, failed = linalg.lapack.dpotrf(unit, lower=True, clean=True)
    clear = not failed and np.diagonal(factor).min(initial=1.0) ** 2 > CLEAR
    return unit, scale, factor if clear else None


def _inverse_root(unit: Array, scale: Array) -> Array:
    """By eigenvalues, where Cholesky's factor is not clear."""
    size, axes = eigh(unit)
    return np.asarray(scale[:, None] * axes / np.sqrt(np.maximum(size, ROUNDING)))
