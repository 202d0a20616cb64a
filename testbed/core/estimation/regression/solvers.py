"""Weighted least squares by normal equations, or by a QR decomposition of all rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from scipy import linalg

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.base.errors import UnidentifiableParameters, UnknownName
from testbed.core.estimation.regression.normal_equations import (
    NormalEquations,
    inverse_and_solution,
    unit_diagonal,
)

MIN_RELATIVE_NOISE = 1e-7
"""Smallest noise of a channel relative to its measurement that sums of products resolve."""


def noise_weights(equations: NormalEquations) -> Array:
    """Weights of the channels, (C,): inverse variances of their noise, estimated iteratively.

    The variances are mean squared residuals of weighted fits, in four iterations, limited below by
    MIN_RELATIVE_NOISE.

    Args:
        equations: Normal equations of all rows.
    """
    rms = equations.rms
    floor = np.maximum(
        MIN_RELATIVE_NOISE * rms, MIN_RELATIVE_NOISE**2 * (rms.max() or 1.0)
    )
    unknowns_per_channel = len(equations.unknowns) / len(rms)
    free, weights = (
        np.maximum(equations.used - unknowns_per_channel, 1.0),
        np.ones(len(rms)),
    )
    # iterations: noise variances from the residuals, then new weights
    for _ in range(4):
        values = minimum_norm(equations.matrix(weights), equations.vector(weights))
        squares = equations.residual(values)
        weights = 1 / np.maximum(squares / free, floor**2)
    return weights


def minimum_norm(matrix: Array, vector: Array) -> Array:
    """Minimum-norm solution of matrix x = vector, scaled to unit diagonal, for any rank.

    Args:
        matrix: Symmetric matrix, (p, p).
        vector: Right-hand side, (p,).
    """
    unit, scale = unit_diagonal(matrix)
    return np.asarray(np.linalg.lstsq(unit, vector / scale, rcond=1e-13)[0] / scale)


Rows = Callable[[Array], Iterator[tuple[Array, Array]]]
"""Function that starts a pass over all rows. Its argument is a matrix that combines the columns,
(p, q); it yields blocks of combined columns, (C, k, q), and of measurements, (C, k)."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Weighted least-squares solution.

    Attributes:
        values: Values of the unknowns, (p,); nan for unknowns without influence on a weighted
            channel.
        inverse: Inverse of X' W X, (p, p); nan for the same unknowns.
        weights: Weights of the channels, (C,).
        condition: Condition number of the weighted equations with columns of unit length.
    """

    values: Array
    inverse: Array
    weights: Array
    condition: float


def raise_unidentifiable_parameters(
    names: Sequence[str], directions: Array, rows: int
) -> NoReturn:
    """Raise UnidentifiableParameters with the names of the unknowns in undetermined directions.

    Unknowns with a component above 0.1 in an undetermined direction are named.

    Args:
        names: Names of the unknowns, (p,).
        directions: Undetermined directions, (k, p).
        rows: Number of rows.

    Raises:
        UnidentifiableParameters: Always.
    """
    shares = abs(directions).max(axis=0)
    # component in an undetermined direction above which an unknown is named
    unseen = [name for name, share in zip(names, shares, strict=True) if share > 0.1]
    raise UnidentifiableParameters(
        unseen, len(names) - len(directions), len(names), rows
    )


def solve_normal_equations(equations: NormalEquations, weights: Array) -> Fit:
    """Solve the weighted normal equations.

    Rounding errors grow with the square of the condition number. Unknowns without influence on a
    weighted channel are nan.

    Args:
        equations: Normal equations of all rows.
        weights: Weights of the channels, (C,).

    Raises:
        UnidentifiableParameters: The equations do not determine all unknowns that influence them;
            lists the names.
    """
    matrix, vector, rows = (
        equations.matrix(weights),
        equations.vector(weights),
        equations.rows,
    )
    nonzero = np.flatnonzero(np.diagonal(matrix))
    if not len(nonzero):
        raise UnidentifiableParameters(
            equations.unknowns, 0, len(equations.unknowns), rows
        )
    submatrix = matrix[np.ix_(nonzero, nonzero)]
    eigenvalues, directions = eigh(unit_diagonal(submatrix)[0])
    undetermined = (
        eigenvalues <= len(eigenvalues) * np.finfo(float).eps * eigenvalues[-1]
    )
    if undetermined.any():
        raise_unidentifiable_parameters(
            [equations.unknowns[k] for k in nonzero],
            directions[:, undetermined].T,
            rows,
        )
    values, inverse = np.full(len(matrix), np.nan), np.full(matrix.shape, np.nan)
    inverse[np.ix_(nonzero, nonzero)], values[nonzero] = inverse_and_solution(
        submatrix, vector[nonzero]
    )
    return Fit(
        values, inverse, weights, float(np.sqrt(eigenvalues[-1] / eigenvalues[0]))
    )


def solve_by_qr(equations: NormalEquations, weights: Array, rows: Rows) -> Fit:
    """Solve the weighted equations by a QR decomposition of all rows.

    Rounding errors grow with the condition number.

    Args:
        equations: Normal equations of all rows.
        weights: Weights of the channels, (C,).
        rows: Function that starts a pass over all rows; each block updates the triangular factor.

    Raises:
        UnidentifiableParameters: The equations do not determine all unknowns; lists the names.
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
    _, singular_values, directions = np.linalg.svd(triangle[:p, :p])
    # singular values of the scaled equations below this share of the largest count as zero
    undetermined = singular_values <= 1e-10 * singular_values[0]
    if undetermined.any():
        raise_unidentifiable_parameters(
            equations.unknowns, directions[undetermined], equations.rows
        )
    root = linalg.inv(triangle[:p, :p]) / scale[:, None]
    return Fit(
        root @ triangle[:p, p],
        root @ root.T,
        weights,
        float(singular_values[0] / singular_values[-1]),
    )


def solve(equations: NormalEquations, weights: Array, rows: Rows) -> Fit:
    """Solve by normal equations, or by QR where these are ill-conditioned.

    QR is used for a condition number above 1e4, or if normal equations do not determine all
    unknowns.

    Args:
        equations: Normal equations of all rows.
        weights: Weights of the channels, (C,).
        rows: Function that starts a pass over all rows.

    Raises:
        UnidentifiableParameters: The equations do not determine all unknowns; lists the names.
    """
    # the rows may determine unknowns that sums of products do not, by rounding
    with suppress(UnidentifiableParameters):
        solution = solve_normal_equations(equations, weights)
        # condition up to which normal equations are as good as a QR of all rows
        if solution.condition <= 1e4 and not np.isnan(solution.values).any():
            return solution
    return solve_by_qr(equations, weights, rows)


def fit(equations: NormalEquations, weights: Mapping[str, float] | None = None) -> Fit:
    """Fit all or some of the channels, with given or estimated weights.

    No pass over the samples is needed.

    Args:
        equations: Normal equations of a recording, `Estimate.normal_equations`.
        weights: Inverse noise variance of each channel [N^-2, (N m)^-2], keyed by name; other
            channels are left out. Default: all channels, weighted by their residuals.

    Raises:
        UnknownName: A channel does not exist.
        UnidentifiableParameters: The channels cannot distinguish all parameters that influence
            them.
    """
    if weights is None:
        chosen = noise_weights(equations)
    else:
        for name in weights:
            if name not in equations.channels:
                raise UnknownName("channel", name, equations.channels)
        chosen = np.array([float(weights.get(c, 0.0)) for c in equations.channels])
    return solve_normal_equations(equations, chosen)
