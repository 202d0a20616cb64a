"""Restricted likelihood of variance components under autoregressive noise.

The model is y = X theta + sum over families f of Z_f u_f + e, with u_f ~ N(0, lambda_f) and an
autoregression e in each channel. For rows whitened by the autoregressions, with the projection P
that removes X, G = Z' P Z and c = Z' P y, the logarithm of the restricted likelihood is

    -sum_c n_c log sigma_c - 1/2 log |X'X| - 1/2 log |1 + D G| - nu/2 log(rss / nu)

where n_c is the number of rows of channel c, nu the number of degrees of freedom, D the diagonal
matrix of the variances lambda, and rss the remaining sum of squares.

Source    [PT71]; [Har77]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.estimation.noise.lagged_products import (
    MAX_AUTOREGRESSION_ORDER,
    Autoregression,
    best_order,
    fit_autoregression,
    innovation_variance,
    whitening_filter,
)
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE

Indices = NDArray[np.intp]

VARIANCE_GRID = 10.0 ** np.arange(-5, 2.01, 0.25)
"""Variances of a family that are tried, in squares of the plausible size over the noise's."""

RANK_TOLERANCE = 1e-8
"""Relative tolerance of the rank of the unknowns' columns."""

DEPENDENT_SHARE = 1e-9
"""Part of a column's square left by the unknowns, below which it counts as dependent."""

MAX_LOST_SHARE = 0.6
"""Largest part of the degrees of freedom that counts as taken by a fit."""


class RowNoise(NamedTuple):
    """Noise model for rows of C channels.

    Attributes:
        process: Autoregressions of the channels.
        total: Standard deviations of the noise, (C,).
    """

    process: Autoregression
    total: Array


@dataclass(frozen=True, eq=False)
class RegressionRows:
    """Rows of unknowns, families and measurements.

    Attributes:
        columns: Columns of the unknowns, (C, R, p), of C channels, R rows and p unknowns.
        measured: Measurements, (C, R).
        row_mask: True for rows that are used, (C, R).
        families: Columns of each family, (C, R, k) each, keyed by kind.
        prior: Rows of prior information on the unknowns and their right-hand side, with unit noise,
            (r, p + 1).
    """

    columns: Array
    measured: Array
    row_mask: NDArray[np.bool_]
    families: Mapping[str, Array]
    prior: Array

    @property
    def count(self) -> Array:
        """Number of rows used in each channel, at least 1, (C,)."""
        return np.asarray(np.maximum(self.row_mask.sum(axis=1), 1.0))

    def whitened_rows(self, rows: Array, noise: RowNoise) -> Array:
        """Whiten rows, (C, R, k), to unit noise, (C (R - P), k).

        The first P rows, where P is the order of the autoregressions, are left out; masked rows are
        zero.

        Args:
            rows: Columns or residuals, (C, R, k).
            noise: Noise of the rows.
        """
        alpha, order = (
            whitening_filter(noise.process.coefficients),
            noise.process.order,
        )
        length = rows.shape[1] - order
        white = sum(
            alpha[:, i, None, None] * rows[:, order - i : order - i + length]
            for i in range(order + 1)
        )
        scale = self.row_mask[:, order:] / noise.process.sigma[:, None]
        return np.asarray(white * scale[..., None]).reshape(-1, rows.shape[2])

    def fit_noise(self, residual: Array, freedom: float) -> RowNoise:
        """Fit autoregressions to residuals, with the order chosen by Akaike's criterion.

        The order is common to all channels. Variances are computed per degree of freedom; the fit
        is assumed to take at most a fraction MAX_LOST_SHARE of these.

        Args:
            residual: Residuals, (C, R), zero in masked rows.
            freedom: Number of degrees of freedom that the regression removes from the residuals.
        """
        length, count = residual.shape[1], self.count
        lags = [
            (residual[:, k:] * residual[:, : length - k]).sum(axis=1) / count
            for k in range(MAX_AUTOREGRESSION_ORDER + 1)
        ]
        lag_matrix = np.abs(
            np.subtract.outer(
                np.arange(MAX_AUTOREGRESSION_ORDER + 1),
                np.arange(MAX_AUTOREGRESSION_ORDER + 1),
            )
        )
        moments = np.stack(lags, axis=1)[:, lag_matrix] + SMALLEST_POSITIVE * np.eye(
            MAX_AUTOREGRESSION_ORDER + 1
        )
        order = best_order(moments, int(count.max()))
        coefficients = fit_autoregression(moments, order)
        free = count * (1 - min(freedom / count.sum(), MAX_LOST_SHARE)) / count
        variance = innovation_variance(moments, coefficients) / free
        sigma = np.sqrt(np.maximum(variance, SMALLEST_POSITIVE))
        total = np.sqrt(np.maximum(lags[0] / free, SMALLEST_POSITIVE))
        return RowNoise(Autoregression(coefficients, sigma), total)


class Solution(NamedTuple):
    """Posterior mean and covariance of unknowns and family coefficients.

    Attributes:
        values: Unknowns, then coefficients relative to plausible sizes, (p + k,).
        covariance: Covariance of the values, (p + k, p + k).
        freedom: Degrees of freedom taken by the fit.
    """

    values: Array
    covariance: Array
    freedom: float


class ProjectedRows:
    """Whitened rows with the unknowns projected out by QR decomposition.

    They give the likelihood and the solution for any variances of the families. X are the whitened
    columns of the unknowns, with prior rows appended, and Z those of the families.

    Attributes:
        rows: Rows of unknowns and all families.
        kinds: Kinds of families in use.
        noise: Noise model used to whiten the rows.
        indices: Indices of each family's columns in Z, keyed by kind.
        p: Number of unknowns.
        free: Number of whitened rows minus p, at least 1.
    """

    def __init__(
        self, rows: RegressionRows, kinds: Sequence[str], noise: RowNoise
    ) -> None:
        """Whiten the rows of unknowns and selected families, and project out the unknowns.

        Args:
            rows: Rows of unknowns and all families.
            kinds: Kinds of families in use.
            noise: Noise model used to whiten the rows.
        """
        self.rows, self.kinds, self.noise = rows, tuple(kinds), noise
        blocks = [rows.families[kind] for kind in kinds]
        ends = np.cumsum([0, *(each.shape[2] for each in blocks)])
        self.indices = {
            kind: np.arange(first, last)
            for kind, first, last in zip(kinds, ends, ends[1:], strict=False)
        }
        blocks_with_measured = [rows.columns, *blocks, rows.measured[..., None]]
        white = rows.whitened_rows(np.concatenate(blocks_with_measured, axis=2), noise)
        self.p = rows.columns.shape[2]
        prior = np.zeros((len(rows.prior), white.shape[1]))
        prior[:, : self.p], prior[:, -1] = rows.prior[:, :-1], rows.prior[:, -1]
        white = np.concatenate([white[white.any(axis=1)], prior])
        self.free = max(float(len(white)) - self.p, 1.0)
        unknowns, others = np.split(white, [self.p], axis=1)
        orthonormal, self._triangle = np.linalg.qr(unknowns)
        self._coordinates = orthonormal.T @ others
        projected = others - orthonormal @ self._coordinates
        size = np.linalg.norm(others, axis=0)
        dependent = np.linalg.norm(projected, axis=0) < np.sqrt(DEPENDENT_SHARE) * size
        dependent[-1] = False
        projected[:, dependent] = 0.0
        self._projected, self._residual = projected[:, :-1], projected[:, -1]

    @cached_property
    def regression_coefficients(self) -> Array:
        """Regression of each family's column and the measurements on the unknowns, (p, k + 1)."""
        scale = _column_scales(self._triangle)
        solution = np.linalg.lstsq(
            self._triangle * scale, self._coordinates, RANK_TOLERANCE
        )[0]
        return np.asarray(scale[:, None] * solution)

    @cached_property
    def covariance(self) -> Array:
        """Covariance (X'X)^-1 of the unknowns in a model without families, (p, p).

        The noise has variance one; undetermined directions (RANK_TOLERANCE) have variance zero.
        """
        scale = _column_scales(self._triangle)
        inverse = scale[:, None] * np.linalg.pinv(
            self._triangle * scale, RANK_TOLERANCE
        )
        return np.asarray(inverse @ inverse.T)

    @property
    def information(self) -> Array:
        """Information matrix of the unknowns, X'X, (p, p)."""
        return np.asarray(self._triangle.T @ self._triangle)

    @property
    def cross(self) -> Array:
        """Products of the unknowns' columns and the families' columns, X'Z, (p, k)."""
        return np.asarray(self._triangle.T @ self._coordinates[:, :-1])

    @cached_property
    def _log_determinant(self) -> float:
        """Logarithm of the determinant of X'X.

        Dependent columns contribute with RANK_TOLERANCE times their length.
        """
        least = RANK_TOLERANCE * np.linalg.norm(self._triangle, axis=0)
        size = np.maximum(
            np.abs(np.diagonal(self._triangle)), np.maximum(least, SMALLEST_POSITIVE)
        )
        return float(2 * np.log(size).sum())

    @cached_property
    def _measured_products(self) -> tuple[Array, float]:
        """Products of projected family columns and measurements, (k,), and squared measurements."""
        square = max(float(self._residual @ self._residual), SMALLEST_POSITIVE)
        return self._projected.T @ self._residual, square

    def _gram(self, one: Indices, other: Indices) -> Array:
        """Products of two groups of projected family columns, (a, b)."""
        return np.asarray(self._projected[:, one].T @ self._projected[:, other])

    def gain(self, kind: str, chosen: Mapping[str, float]) -> tuple[float, float]:
        """Gain of the log likelihood due to one more family [nats], and the best variance.

        Both are zero if no variance of VARIANCE_GRID increases the likelihood.

        Args:
            kind: Kind of the family.
            chosen: Variances of the families already chosen, keyed by kind.
        """
        moment, rss = self._measured_products
        indices = self.indices[kind]
        gram, right = self._gram(indices, indices), moment[indices]
        if chosen:
            others, variances = self._chosen_columns(chosen)
            root = self._cholesky_factor(others, variances)
            cross = solve_triangular(root, self._gram(others, indices), lower=True)
            solved = solve_triangular(root, moment[others], lower=True)
            gram, right = gram - cross.T @ cross, right - cross.T @ solved
            rss = max(rss - float(solved @ solved), SMALLEST_POSITIVE)
        return self._best_gain(gram, right, rss)

    def _best_gain(self, gram: Array, right: Array, rss: float) -> tuple[float, float]:
        """Largest gain of the log likelihood over VARIANCE_GRID, and the variance.

        Both are zero without a positive gain.

        Args:
            gram: Products of a family's columns, (k, k).
            right: Products of these columns and the measurements, (k,).
            rss: Sum of squares of the measurements.
        """
        sizes, axes = eigh((gram + gram.T) / 2)
        independent = sizes > DEPENDENT_SHARE * max(
            float(sizes.max(initial=0.0)), SMALLEST_POSITIVE
        )
        projections = (axes.T @ right)[independent] ** 2
        growth = 1 + VARIANCE_GRID[:, None] * sizes[independent]
        remaining = rss - (VARIANCE_GRID[:, None] * projections / growth).sum(axis=1)
        remaining = np.maximum(remaining, 1e-9 * rss)
        gains = -0.5 * (
            np.log(growth).sum(axis=1) + self.free * np.log(remaining / rss)
        )
        best = int(gains.argmax())
        if gains[best] <= 0:
            return 0.0, 0.0
        return float(gains[best]), float(VARIANCE_GRID[best])

    def _chosen_columns(
        self, chosen: Mapping[str, float]
    ) -> tuple[NDArray[np.intp], Array]:
        """Column indices of chosen families, (k,), and their variances, (k,)."""
        if not chosen:
            return np.zeros(0, np.intp), np.zeros(0)
        blocks = [self.indices[kind] for kind in chosen]
        variances = [
            np.full(len(each), value)
            for each, value in zip(blocks, chosen.values(), strict=True)
        ]
        return np.concatenate(blocks), np.concatenate(variances)

    def _cholesky_factor(self, indices: NDArray[np.intp], variances: Array) -> Array:
        """Cholesky factor of G + D^-1 for selected columns, (k, k).

        Args:
            indices: Column indices, (k,).
            variances: Diagonal of D, (k,).
        """
        gram = self._gram(indices, indices)
        ridge = np.diag(1 / variances + DEPENDENT_SHARE * np.diagonal(gram))
        return np.asarray(cholesky(gram + ridge, lower=True))

    def tuned_variances(
        self, chosen: Mapping[str, float], rounds: int
    ) -> dict[str, float]:
        """Best variances of chosen families, by coordinate ascent of the likelihood.

        Each round sets the variances in turn to the best values of VARIANCE_GRID; families without
        gain are dropped.

        Args:
            chosen: Variances of families, keyed by kind.
            rounds: Number of rounds.
        """
        variances = dict(chosen)
        for _ in range(rounds):
            for kind in tuple(variances):
                others = {k: v for k, v in variances.items() if k != kind}
                _, variances[kind] = self.gain(kind, others)
                if not variances[kind]:
                    del variances[kind]
        return variances

    def log_likelihood(self, chosen: Mapping[str, float]) -> float:
        """Restricted log likelihood minus the number of noise coefficients (Akaike's penalty).

        Values for different noise models are comparable.

        Args:
            chosen: Variances of families, keyed by kind.
        """
        moment, rss = self._measured_products
        indices, variances = self._chosen_columns(chosen)
        log_determinant = self._log_determinant
        if len(indices):
            root = self._cholesky_factor(indices, variances)
            solved = solve_triangular(root, moment[indices], lower=True)
            rss = max(rss - float(solved @ solved), SMALLEST_POSITIVE)
            log_determinant += float(
                2 * np.log(np.diagonal(root)).sum() + np.log(variances).sum()
            )
        process = self.noise.process
        logs = float(self.rows.count @ np.log(process.sigma))
        free = self.free * np.log(rss / self.free)
        return float(-logs - 0.5 * (log_determinant + free) - process.coefficients.size)

    def solve(self, chosen: Mapping[str, float]) -> Solution:
        """Solve for the unknowns and the coefficients of chosen families.

        The covariance is proportional to the variance of the remaining whitened residuals.

        Args:
            chosen: Variances of families, keyed by kind.
        """
        moment, rss = self._measured_products
        indices, variances = self._chosen_columns(chosen)
        shift, p = self.regression_coefficients[:, indices], self.p
        coefficients, inverse = np.zeros(0), np.zeros((0, 0))
        if len(indices):
            root = self._cholesky_factor(indices, variances)
            inverse = np.asarray(cho_solve((root, True), np.eye(len(indices))))
            coefficients = inverse @ moment[indices]
        values = np.concatenate(
            [self.regression_coefficients[:, -1] - shift @ coefficients, coefficients]
        )
        covariance = np.zeros((len(values), len(values)))
        covariance[:p, :p] = self.covariance + shift @ inverse @ shift.T
        covariance[:p, p:] = -shift @ inverse
        covariance[p:, :p], covariance[p:, p:] = covariance[:p, p:].T, inverse
        square = (rss - float(coefficients @ moment[indices])) / self.free
        shrinkage = float((np.diagonal(inverse) / variances).sum())
        prior = self.rows.prior[:, :-1]
        shrinkage += float(((prior @ covariance[:p, :p]) * prior).sum())
        freedom = len(values) - shrinkage
        return Solution(values, covariance * max(square, SMALLEST_POSITIVE), freedom)


def _column_scales(matrix: Array) -> Array:
    """Factors that scale columns to length one; one for zero columns."""
    length = np.linalg.norm(matrix, axis=0)
    return np.asarray(1 / np.where(length > 0, length, 1.0))
