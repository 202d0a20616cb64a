"""Weighted least squares by normal equations, or by a QR of all rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from scipy import linalg

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.base.errors import UnknownName, UnseenParameters
from testbed.core.estimation.regression.normal_equations import (
    NormalEquations,
    inverse_and_solution,
    unit_diagonal,
)

PRECISION = 1e-7
"""Least noise of a channel relative to its measurement: what sums of products can resolve."""


def noise_weights(equations: NormalEquations) -> Array:
    """Weights of the channels, (C,): one over the variance of each one's own noise.

    Args:
        equations: Of all rows.
    """
    rms = equations.rms
    floor = np.maximum(PRECISION * rms, PRECISION**2 * (rms.max() or 1.0))
    share = len(equations.unknowns) / len(rms)
    free, weights = np.maximum(equations.used - share, 1.0), np.ones(len(rms))
    # times that the channels' noise is estimated anew from the residuals
    for _ in range(4):
        values = minimum_norm(equations.matrix(weights), equations.vector(weights))
        squares = equations.residual(values)
        weights = 1 / np.maximum(squares / free, floor**2)
    return weights


def minimum_norm(matrix: Array, vector: Array) -> Array:
    """Solution of least norm of matrix x = vector, with unit diagonal, whatever the condition.

    Args:
        matrix: Symmetric, (p, p).
        vector: (p,).
    """
    unit, scale = unit_diagonal(matrix)
    return np.asarray(np.linalg.lstsq(unit, vector / scale, rcond=1e-13)[0] / scale)


Rows = Callable[[Array], Iterator[tuple[Array, Array]]]
"""Starts a pass over all rows, with columns combined by a matrix, (p, q): blocks of combined
columns, (C, k, q), and of measurements, (C, k)."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A weighted least-squares solution.

    Attributes:
        values: (p,); nan for what no weighted channel sees.
        inverse: Inverse of X' W X, (p, p); nan likewise.
        weights: Of the channels, (C,).
        condition: Of the weighted equations with columns of unit length.
    """

    values: Array
    inverse: Array
    weights: Array
    condition: float


def refuse(names: Sequence[str], directions: Array, rows: int) -> NoReturn:
    """Raise with the names of the unknowns that have a part in directions, (k, p), unseen."""
    parts = abs(directions).max(axis=0)
    # part in a direction that the data miss beyond which an unknown is named
    unseen = [name for name, part in zip(names, parts, strict=True) if part > 0.1]
    raise UnseenParameters(unseen, len(names) - len(directions), len(names), rows)


def by_normal_equations(equations: NormalEquations, weights: Array) -> Fit:
    """The solution for given weights; errors grow with the square of the condition.

    Args:
        equations: Of all rows.
        weights: Of the channels, (C,).

    Raises:
        UnseenParameters: The equations do not determine all they see; names them.
    """
    matrix, vector, rows = (
        equations.matrix(weights),
        equations.vector(weights),
        equations.rows,
    )
    present = np.flatnonzero(np.diagonal(matrix))
    if not len(present):
        raise UnseenParameters(equations.unknowns, 0, len(equations.unknowns), rows)
    part = matrix[np.ix_(present, present)]
    spread, directions = eigh(unit_diagonal(part)[0])
    lost = spread <= len(spread) * np.finfo(float).eps * spread[-1]
    if lost.any():
        refuse([equations.unknowns[k] for k in present], directions[:, lost].T, rows)
    values, inverse = np.full(len(matrix), np.nan), np.full(matrix.shape, np.nan)
    inverse[np.ix_(present, present)], values[present] = inverse_and_solution(
        part, vector[present]
    )
    return Fit(values, inverse, weights, float(np.sqrt(spread[-1] / spread[0])))


def by_orthogonal_columns(
    equations: NormalEquations, weights: Array, rows: Rows
) -> Fit:
    """The solution for given weights by a QR of all rows; errors grow with the condition.

    Args:
        equations: Of all rows.
        weights: Of the channels, (C,).
        rows: Passed over once, block after block onto one triangle.

    Raises:
        UnseenParameters: The equations do not determine all unknowns; names them.
    """
    _, scale = unit_diagonal(equations.matrix(weights))
    p = len(scale)
    triangle = np.zeros((p + 1, p + 1))
    for columns, measured in rows(np.diag(1 / scale)):
        stack = np.concatenate([columns, measured[..., None]], axis=2)
        white = (np.sqrt(weights)[:, None, None] * stack).reshape(-1, p + 1)
        (triangle,) = linalg.qr(
            np.vstack([triangle, white]), mode="r", check_finite=False
        )
    _, spread, directions = np.linalg.svd(triangle[:p, :p])
    # singular values of the scaled equations below this share of the largest count as zero
    lost = spread <= 1e-10 * spread[0]
    if lost.any():
        refuse(equations.unknowns, directions[lost], equations.rows)
    root = linalg.inv(triangle[:p, :p]) / scale[:, None]
    return Fit(
        root @ triangle[:p, p], root @ root.T, weights, float(spread[0] / spread[-1])
    )


def solve(equations: NormalEquations, weights: Array, rows: Rows) -> Fit:
    """The solution by the normal equations, or by all rows where those are too ill-conditioned.

    Args:
        equations: Of all rows.
        weights: Of the channels, (C,).
        rows: Starts a pass over all rows.

    Raises:
        UnseenParameters: The equations do not determine all unknowns; names them.
    """
    # to the precision of sums; the rows may know better
    with suppress(UnseenParameters):
        solution = by_normal_equations(equations, weights)
        # condition up to which normal equations are as good as a QR of all rows
        if solution.condition <= 1e4 and not np.isnan(solution.values).any():
            return solution
    return by_orthogonal_columns(equations, weights, rows)


def fit(equations: NormalEquations, weights: Mapping[str, float] | None = None) -> Fit:
    """Fit some of the channels, with weights of one's own.

    One channel alone, all but one, or any others: no pass over the samples.

    Args:
        equations: Of a recording; `Estimate.normal_equations`.
        weights: By channel, one over the variance of its noise [N^-2, (N m)^-2]; channels
            that are not named are left out. Default all, by their residuals.

    Raises:
        UnknownName: There is no such channel.
        UnseenParameters: The channels see parameters that they cannot distinguish.
    """
    if weights is None:
        chosen = noise_weights(equations)
    else:
        for name in weights:
            if name not in equations.channels:
                raise UnknownName("channel", name, equations.channels)
        chosen = np.array([float(weights.get(c, 0.0)) for c in equations.channels])
    return by_normal_equations(equations, chosen)
