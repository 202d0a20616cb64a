"""Columns made orthonormal before they are summed: for equations of a large condition."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import linalg

from testbed.arrays import Array
from testbed.identification.regression.least_squares import Fit, Rows, refuse
from testbed.identification.regression.normal_equations import NormalEquations

TRIANGLE = 1e6
"""Condition up to which normal equations tell how to make columns orthonormal."""

RANK_TOLERANCE = 1e-10
"""Singular values of the scaled equations below this share of the largest count as zero."""


def by_orthogonal_columns(equations: NormalEquations, weights: Array, rows: Rows) -> Fit:
    """The solution for given weights; errors grow with the condition, not with its square.

    The triangle that makes the columns orthonormal comes from the normal equations, or, above
    TRIANGLE, from a QR of all rows.

    Args:
        equations: Of all rows.
        weights: W, (C, C).
        rows: Passed over twice, or three times.

    Raises:
        UnseenParameters: The equations do not determine all unknowns; names them.
    """
    matrix: Array = equations.matrix(weights)
    root: Array = np.asarray(np.linalg.cholesky(weights), dtype=np.float64)
    scale = np.sqrt(np.diagonal(matrix))
    scale[scale == 0] = 1.0
    unit = matrix / np.outer(scale, scale)
    factor, failed = linalg.lapack.dpotrf(unit)
    if failed or np.linalg.cond(unit) >= TRIANGLE**2:
        triangle = _triangle(root, scale, rows)
    else:
        triangle = np.triu(factor)
    _, spread, directions = np.linalg.svd(triangle)
    lost = spread <= RANK_TOLERANCE * spread[0]
    if lost.any():
        refuse(equations.unknowns, directions[lost], int(equations.used.sum()))
    lead = linalg.inv(triangle) / scale[:, None]
    values = np.zeros(len(scale))
    for _ in range(2):  # the second time on what the first has left
        gram, vector = np.zeros_like(matrix), np.zeros(len(scale))
        for columns, left in _white(root, lead, values, rows):
            gram += columns.T @ columns
            vector += columns.T @ left
        values = values + lead @ np.linalg.solve(gram, vector)
    inverse = lead @ np.linalg.inv(gram) @ lead.T
    condition = float(spread[0] / spread[-1])
    return Fit(values, inverse, weights, condition, correctable=False)


def _triangle(root: Array, scale: Array, rows: Rows) -> Array:
    """R of a QR of all rows, block after block onto one triangle, (p, p)."""
    triangle = np.zeros((0, len(scale)))
    for columns, _ in _white(root, np.diag(1 / scale), np.zeros(len(scale)), rows):
        triangle = np.asarray(np.linalg.qr(np.vstack([triangle, columns]), mode="r"))
    missing = len(scale) - len(triangle)
    return np.vstack([triangle, np.zeros((missing, len(scale)))])


def _white(root: Array, lead: Array, values: Array, rows: Rows) -> Iterator[tuple[Array, Array]]:
    """Rows with noise of unit covariance: columns @ lead, (k, p), and what values leave, (k,)."""
    for columns, measured in rows(np.column_stack([lead, values])):
        left = measured - columns[..., -1]
        stack = np.concatenate([columns[..., :-1], left[..., None]], axis=2)
        white = np.tensordot(root.T, stack, 1).reshape(-1, stack.shape[2])
        yield white[:, :-1], white[:, -1]
