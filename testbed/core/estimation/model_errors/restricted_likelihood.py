"""Restricted likelihood of variance components beside unknowns, under autoregressive noise.

y = X theta + sum over families of Z_f u_f + e, u_f ~ N(0, lambda_f), e of one autoregression a
channel. In rows that the autoregressions make white, with X projected out, G = Z' P Z and
c = Z' P y, the logarithm of the restricted likelihood is

    -sum_c n_c log sigma_c - 1/2 log |X'X| - 1/2 log |1 + D G| - nu/2 log(rss / nu)

with D of the variances lambda and rss what is left of the squares.

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
    HIGHEST,
    Autoregression,
    best_order,
    fit,
    innovation_variance,
    prediction_errors,
)
from testbed.core.estimation.regression.normal_equations import TINY

Indices = NDArray[np.intp]

VARIANCES = 10.0 ** np.arange(-5, 2.01, 0.25)
"""Variances of a family that are tried, in squares of the plausible size over the noise's."""

SMALL = 1e-8
"""Part of a column that others leave of it where they imitate it but for rounding."""

DEPENDENT = 1e-9
"""Part of a column's square that the unknowns leave of it where they imitate it."""

MOST_LOST = 0.6
"""Most degrees of freedom that are lost, as a part."""


class RowNoise(NamedTuple):
    """Noise of C channels in rows.

    Attributes:
        process: Autoregressions.
        total: Standard deviations of the noise itself, (C,).
    """

    process: Autoregression
    total: Array


@dataclass(frozen=True, eq=False)
class RegressionRows:
    """Rows of unknowns, families and measurements.

    Attributes:
        columns: Of the unknowns, (C, R, p).
        measured: (C, R).
        used: Whether a row counts, (C, R).
        families: Columns by kind, (C, R, k) each.
        prior: Rows of what is known of the unknowns before, of unit noise, and what they would
            measure, (r, p + 1).
    """

    columns: Array
    measured: Array
    used: NDArray[np.bool_]
    families: Mapping[str, Array]
    prior: Array

    @property
    def count(self) -> Array:
        """Rows that count, (C,)."""
        return np.asarray(np.maximum(self.used.sum(axis=1), 1.0))

    def whitened(self, rows: Array, noise: RowNoise) -> Array:
        """Rows (C, R, k) of white noise of size one, (C (R - P), k).

        Args:
            rows: Columns or residuals.
            noise: In them.
        """
        alpha, order = (
            prediction_errors(noise.process.coefficients),
            noise.process.order,
        )
        length = rows.shape[1] - order
        white = sum(
            alpha[:, i, None, None] * rows[:, order - i : order - i + length]
            for i in range(order + 1)
        )
        scale = self.used[:, order:] / noise.process.sigma[:, None]
        return np.asarray(white * scale[..., None]).reshape(-1, rows.shape[2])

    def noise(self, residual: Array, lost: float) -> RowNoise:
        """Autoregressions of residuals, of an order by Akaike's criterion.

        Args:
            residual: (C, R).
            lost: Degrees of freedom that a fit has taken.
        """
        length, count = residual.shape[1], self.count
        lags = [
            (residual[:, k:] * residual[:, : length - k]).sum(axis=1) / count
            for k in range(HIGHEST + 1)
        ]
        far = np.abs(np.subtract.outer(np.arange(HIGHEST + 1), np.arange(HIGHEST + 1)))
        moments = np.stack(lags, axis=1)[:, far] + TINY * np.eye(HIGHEST + 1)
        order = best_order(moments, int(count.max()))
        coefficients = fit(moments, order)
        free = count * (1 - min(lost / count.sum(), MOST_LOST)) / count
        variance = innovation_variance(moments, coefficients) / free
        sigma = np.sqrt(np.maximum(variance, TINY))
        total = np.sqrt(np.maximum(lags[0] / free, TINY))
        return RowNoise(Autoregression(coefficients, sigma), total)


class Solution(NamedTuple):
    """Posterior of unknowns and coefficients of families.

    Attributes:
        values: Unknowns, then coefficients in plausible sizes, (p + k,).
        covariance: (p + k, p + k).
        freedom: Degrees of freedom that are taken.
    """

    values: Array
    covariance: Array
    freedom: float


class ProjectedRows:
    """White rows with the unknowns projected out: what any variances of families need to know."""

    def __init__(
        self, rows: RegressionRows, kinds: Sequence[str], noise: RowNoise
    ) -> None:
        """White rows of unknowns and some families.

        Args:
            rows: All rows.
            kinds: The families.
            noise: That makes the rows white.
        """
        self.rows, self.kinds, self.noise = rows, tuple(kinds), noise
        blocks = [rows.families[kind] for kind in kinds]
        ends = np.cumsum([0, *(each.shape[2] for each in blocks)])
        self.places = {
            kind: np.arange(first, last)
            for kind, first, last in zip(kinds, ends, ends[1:], strict=False)
        }
        every = [rows.columns, *blocks, rows.measured[..., None]]
        white = rows.whitened(np.concatenate(every, axis=2), noise)
        self.p = rows.columns.shape[2]
        known = np.zeros((len(rows.prior), white.shape[1]))
        known[:, : self.p], known[:, -1] = rows.prior[:, :-1], rows.prior[:, -1]
        white = np.concatenate([white[white.any(axis=1)], known])
        self.free = max(float(len(white)) - self.p, 1.0)
        own, others = np.split(white, [self.p], axis=1)
        basis, self._root = np.linalg.qr(own)
        self._across = basis.T @ others
        left = others - basis @ self._across
        size = np.linalg.norm(others, axis=0)
        imitated = np.linalg.norm(left, axis=0) < np.sqrt(DEPENDENT) * size
        imitated[-1] = False
        left[:, imitated] = 0.0
        self._left, self._residual = left[:, :-1], left[:, -1]

    @cached_property
    def shift(self) -> Array:
        """Unknowns by each family's column and by the measurements alone, (p, k + 1)."""
        scale = _scale(self._root)
        found = np.linalg.lstsq(self._root * scale, self._across, SMALL)[0]
        return np.asarray(scale[:, None] * found)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the unknowns without families, under noise of one, (p, p)."""
        scale = _scale(self._root)
        inverse = scale[:, None] * np.linalg.pinv(self._root * scale, SMALL)
        return np.asarray(inverse @ inverse.T)

    @property
    def information(self) -> Array:
        """Products of the unknowns' columns, (p, p)."""
        return np.asarray(self._root.T @ self._root)

    @property
    def cross(self) -> Array:
        """Products of the unknowns' columns and the families', (p, k)."""
        return np.asarray(self._root.T @ self._across[:, :-1])

    @cached_property
    def _log_size(self) -> float:
        """Logarithm of |X'X|."""
        least = SMALL * np.linalg.norm(self._root, axis=0)
        size = np.maximum(np.abs(np.diagonal(self._root)), np.maximum(least, TINY))
        return float(2 * np.log(size).sum())

    @cached_property
    def _squares(self) -> tuple[Array, float]:
        """Products of families' columns and measurements, (k,), and squares of these."""
        own = max(float(self._residual @ self._residual), TINY)
        return self._left.T @ self._residual, own

    def _gram(self, one: Indices, other: Indices) -> Array:
        """Products of columns, unknowns projected out, (a, b)."""
        return np.asarray(self._left[:, one].T @ self._left[:, other])

    def gain(self, kind: str, chosen: Mapping[str, float]) -> tuple[float, float]:
        """Gain of the log likelihood by a family beside chosen ones, and its best variance.

        Args:
            kind: Of the family.
            chosen: Variances of the others by kind.
        """
        moment, rss = self._squares
        at = self.places[kind]
        own, right = self._gram(at, at), moment[at]
        if chosen:
            others, variances = self._of(chosen)
            root = self._root_of(others, variances)
            across = solve_triangular(root, self._gram(others, at), lower=True)
            known = solve_triangular(root, moment[others], lower=True)
            own, right = own - across.T @ across, right - across.T @ known
            rss = max(rss - float(known @ known), TINY)
        return self._best(own, right, rss)

    def _best(self, own: Array, right: Array, rss: float) -> tuple[float, float]:
        """Largest gain, and the variance that has it.

        Args:
            own: Products of a family's columns, (k, k).
            right: Of these and the measurements, (k,).
            rss: Squares of the measurements.
        """
        sizes, axes = eigh((own + own.T) / 2)
        seen = sizes > DEPENDENT * max(float(sizes.max(initial=0.0)), TINY)
        along = (axes.T @ right)[seen] ** 2
        growth = 1 + VARIANCES[:, None] * sizes[seen]
        left = rss - (VARIANCES[:, None] * along / growth).sum(axis=1)
        left = np.maximum(left, 1e-9 * rss)
        gains = -0.5 * (np.log(growth).sum(axis=1) + self.free * np.log(left / rss))
        best = int(gains.argmax())
        if gains[best] <= 0:
            return 0.0, 0.0
        return float(gains[best]), float(VARIANCES[best])

    def _of(self, chosen: Mapping[str, float]) -> tuple[NDArray[np.intp], Array]:
        """Columns of chosen families, (k,), and their variances, (k,)."""
        if not chosen:
            return np.zeros(0, np.intp), np.zeros(0)
        at = [self.places[kind] for kind in chosen]
        variances = [
            np.full(len(each), value)
            for each, value in zip(at, chosen.values(), strict=True)
        ]
        return np.concatenate(at), np.concatenate(variances)

    def _root_of(self, at: NDArray[np.intp], variances: Array) -> Array:
        """Cholesky factor of G + 1 / D, (k, k)."""
        own = self._gram(at, at)
        ridge = np.diag(1 / variances + DEPENDENT * np.diagonal(own))
        return np.asarray(cholesky(own + ridge, lower=True))

    def tuned(self, chosen: Mapping[str, float], times: int) -> dict[str, float]:
        """Chosen families with their best variances, one after the other.

        Args:
            chosen: Variances by kind; those that gain nothing are left out.
            times: Rounds.
        """
        found = dict(chosen)
        for _ in range(times):
            for kind in tuple(found):
                others = {k: v for k, v in found.items() if k != kind}
                _, found[kind] = self.gain(kind, others)
                if not found[kind]:
                    del found[kind]
        return found

    def likelihood(self, chosen: Mapping[str, float]) -> float:
        """Restricted log likelihood, comparable between noises, less the noise's coefficients.

        Args:
            chosen: Variances by kind.
        """
        moment, rss = self._squares
        at, variances = self._of(chosen)
        size = self._log_size
        if len(at):
            root = self._root_of(at, variances)
            known = solve_triangular(root, moment[at], lower=True)
            rss = max(rss - float(known @ known), TINY)
            size += float(2 * np.log(np.diagonal(root)).sum() + np.log(variances).sum())
        process = self.noise.process
        logs = float(self.rows.count @ np.log(process.sigma))
        free = self.free * np.log(rss / self.free)
        return float(-logs - 0.5 * (size + free) - process.coefficients.size)

    def solve(self, chosen: Mapping[str, float]) -> Solution:
        """Unknowns and coefficients of chosen families.

        Args:
            chosen: Variances by kind.
        """
        moment, rss = self._squares
        at, variances = self._of(chosen)
        shift, p = self.shift[:, at], self.p
        coefficients, inverse = np.zeros(0), np.zeros((0, 0))
        if len(at):
            root = self._root_of(at, variances)
            inverse = np.asarray(cho_solve((root, True), np.eye(len(at))))
            coefficients = inverse @ moment[at]
        values = np.concatenate(
            [self.shift[:, -1] - shift @ coefficients, coefficients]
        )
        covariance = np.zeros((len(values), len(values)))
        covariance[:p, :p] = self.covariance + shift @ inverse @ shift.T
        covariance[:p, p:] = -shift @ inverse
        covariance[p:, :p], covariance[p:, p:] = covariance[:p, p:].T, inverse
        square = (rss - float(coefficients @ moment[at])) / self.free
        given = float((np.diagonal(inverse) / variances).sum())
        known = self.rows.prior[:, :-1]
        given += float(((known @ covariance[:p, :p]) * known).sum())
        freedom = len(values) - given
        return Solution(values, covariance * max(square, TINY), freedom)


def _scale(matrix: Array) -> Array:
    """What makes columns of length one; zero columns stay."""
    length = np.linalg.norm(matrix, axis=0)
    return np.asarray(1 / np.where(length > 0, length, 1.0))
