"""Fits under coloured noise, from products of rows with rows before them.

Channels whose rows have no gaps are whitened by the noise's own autoregression before they are
weighted: generalised least squares. Rows that were dropped, at a joint's reversals, break the
sequence: such channels are weighted only, and the covariance counts how residuals hang
together over neighbouring rows.

Residuals are not the noise: unknowns have taken a part of it, of each channel and at each
frequency another. Of generalised least squares the part is known, E r r' = E e e' - X G X' with G
the unknowns' covariance, and it is added: restricted maximum likelihood, in turns. So it is at
each lag of rows with gaps, as if their noise were white.

Columns of the products: the unknowns' columns, then the residuals, then ones where a row
counts. Rows come in units in which every channel's noise is about one. R residuals beside the
same columns, as replicas of noise are, are fitted side by side, each for itself.

Source    [PT71], [CR00] of autoregressions
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.estimation.noise.lagged_products import (
    HIGHEST,
    Autoregression,
    LaggedProducts,
    Whitened,
    best_order,
    fit,
    innovation_variance,
)
from testbed.core.estimation.regression.normal_equations import inverse_and_solution

LEAST = 1e-4
"""Least noise of a channel, in the units that rows come in: channels without noise are possible."""


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """Unknowns under a noise that was found with them.

    Attributes:
        values: (m,).
        covariance: By the formula of the fit, (m, m).
        noise: Of the residuals.
        weighting: What rows were whitened and weighted by; of rows with gaps, of order zero.
        inverse: Of the normal matrix of these rows, (m, m).
    """

    values: Array
    covariance: Array
    noise: Autoregression
    weighting: Autoregression
    inverse: Array

    def normal(self, given: LaggedProducts) -> Array:
        """The normal matrix of columns, weighted as the fit's own were, (q, q).

        Args:
            given: Products of the columns.
        """
        white = Whitened(given, self.weighting.coefficients[None])
        return np.asarray(white.sums(self.weighting.sigma[None] ** -2.0)[0])


Fits = Callable[[LaggedProducts, int | None], list[NoiseFit]]
"""A fit for each response; the order of the noise is chosen where None is given."""


def whitened_fits(given: LaggedProducts, order: int | None = None) -> list[NoiseFit]:
    """Generalised least squares: rows without gaps.

    Args:
        given: Products of unknowns' columns, residuals and ones.
        order: Of the noise; None for what is best for the first residuals.
    """
    now = given.up_to(0)
    weighted = _weighted(now, given.rows)
    # by residuals as they are: of coloured noise weights alone take less
    if order is None:
        highest = _highest(given, now.unknowns)
        residuals = _squares(_of_residuals(now, weighted.values))
        moments = given.moments(residuals, highest)[0]
        order = highest and best_order(moments, given.after(highest), highest)
    given = given.up_to(order)
    # times that noise and unknowns are found in turns: what is left to go is 1 % of sigma
    for _ in range(4 if order else 1):
        coefficients = fit(_moments(given, weighted, order), order)
        weighted = _weighted(given, given.after(order), coefficients)
    noises = map(Autoregression, coefficients, weighted.spread)
    each = zip(weighted.values, weighted.inverse, noises, strict=True)
    return [
        NoiseFit(values, inverse, noise, noise, inverse)
        for values, inverse, noise in each
    ]


def weighted_fits(given: LaggedProducts, order: int | None = None) -> list[NoiseFit]:
    """Weighted least squares, neighbouring residuals counted in the covariance: rows with gaps.

    Args:
        given: Products of unknowns' columns, residuals and ones.
        order: Of the noise; None for as many as there are lags.
    """
    m, now = given.unknowns, given.up_to(0)
    counts = given.products[:, :, -1, -1].T  # (C, K + 1)
    weighted = _weighted(now, np.maximum(counts[:, 0], 1.0))
    covariances = given.traces(_noise_squares(given, weighted))
    covariances /= np.maximum(counts, 1.0)  # (R, C, K + 1)
    covariances[..., 0] = weighted.spread**2  # which is not zero
    for each in covariances:
        _forget(each, int(np.mean(counts[:, 0])))
    weights = weighted.spread[..., None] ** -4.0 * covariances
    least = now.sums(weights[..., :1])
    weights[..., 1:] *= 2  # a lag's products, and their transpose
    middle = given.sums(weights)
    fits = []
    for r, inverse in enumerate(weighted.inverse):
        # of the variance that independent rows would give: sums over few lags can fall below zero
        inner = _at_least(0.1, least[r, :m, :m], middle[r, :m, :m])
        noise = _from_covariances(
            covariances[r], given.lags if order is None else order
        )
        weighting = Autoregression(np.zeros((len(counts), 0)), weighted.spread[r])
        fits.append(
            NoiseFit(
                weighted.values[r], inverse @ inner @ inverse, noise, weighting, inverse
            )
        )
    return fits


def _highest(given: LaggedProducts, unknowns: int) -> int:
    """Largest order that leaves rows enough for the unknowns, and for itself."""
    # times as many rows as unknowns, of all channels together, that whitening has to leave
    needed = 2 * unknowns // int(given.products.shape[1]) + 1
    # rows that a coefficient of the noise has to be found from
    return max(0, min(HIGHEST, given.lags, given.rows // 10, given.rows - needed))


def _at_least(share: float, least: Array, matrix: Array) -> Array:
    """A covariance that is nowhere below a share of another one."""
    root = np.linalg.cholesky(least)
    inverse = np.linalg.inv(root)
    spread, axes = eigh(inverse @ matrix @ inverse.T)
    half = root @ axes * np.sqrt(np.maximum(spread, share))
    return half @ half.T


class _Weighted(NamedTuple):
    """Weighted least squares, every channel by its own noise, of each response.

    Attributes:
        values: (R, m).
        inverse: Of the normal matrices, (R, m, m).
        spread: Noise of every channel, (R, C).
        taken: Rows' worth of each channel's noise that the unknowns have taken, (R, C).
    """

    values: Array
    inverse: Array
    spread: Array
    taken: Array


def _weighted(
    given: LaggedProducts,
    rows: Array | int,
    coefficients: Array | None = None,
) -> _Weighted:
    """Unknowns and noise from products of the same rows.

    Args:
        given: The products.
        rows: How many, (C,) or one number.
        coefficients: Of the autoregressions that whiten them, (R, C, P); None for none.
    """
    m, trials, channels = given.unknowns, given.responses, given.products.shape[1]
    if coefficients is None:
        coefficients = np.zeros((trials, channels, 0))
    white, free = (
        Whitened(given, coefficients),
        np.asarray(rows) - coefficients.shape[2],
    )
    values, taken = np.zeros((trials, m)), np.full((trials, channels), m / channels)
    inverses = np.zeros((trials, *given.products.shape[2:]))
    spread = _spread(white.squares(_of_residuals(given, values)), free - taken)
    # times that the channels' weights are found anew from the residuals
    for _ in range(3):
        inverses[:, :m, :m], values = _solutions(white.sums(spread**-2.0), m)
        taken = white.traces(inverses) / spread**2
        spread = _spread(white.squares(_of_residuals(given, values)), free - taken)
    inverse, _ = _solutions(white.sums(spread**-2.0), m)
    return _Weighted(values, inverse, spread, taken)


def _solutions(sums: Array, m: int) -> tuple[Array, Array]:
    """Inverses of the normal matrices, (R, m, m), and each response's solution, (R, m)."""
    each = [
        inverse_and_solution(one[:m, :m], one[:m, m + r]) for r, one in enumerate(sums)
    ]
    inverses, values = zip(*each, strict=True)
    return np.stack(inverses), np.stack(values)


def _spread(squares: Array, free: Array) -> Array:
    """Noise of every channel, of squares of residuals and degrees of freedom."""
    return np.maximum(np.sqrt(np.maximum(squares, 0.0) / np.maximum(free, 1.0)), LEAST)


def _moments(given: LaggedProducts, weighted: _Weighted, order: int) -> Array:
    """e_(t-i) e_(t-j) summed over t >= order, of the noise e, (R, C, order + 1, order + 1)."""
    least = LEAST**2 * given.after(order) * np.eye(order + 1)
    return given.moments(_noise_squares(given, weighted), order) + least


def _noise_squares(given: LaggedProducts, weighted: _Weighted) -> Array:
    """B b' of the residuals, and what the unknowns have taken of the noise, (R, q, q)."""
    m, squares = given.unknowns, _squares(_of_residuals(given, weighted.values))
    squares[:, :m, :m] += weighted.inverse
    return squares


def _of_residuals(given: LaggedProducts, values: Array) -> Array:
    """B with b' z what a response's values leave of a row z, (R, q)."""
    trials, m = values.shape
    combinations = np.zeros((trials, given.products.shape[2]))
    combinations[:, :m], combinations[range(trials), range(m, m + trials)] = (
        -values,
        1.0,
    )
    return combinations


def _squares(combinations: Array) -> Array:
    """B b' of each b, (R, q, q)."""
    return combinations[:, :, None] * combinations[:, None, :]


def _forget(covariances: Array, rows: int) -> None:
    """Replace autocovariances beyond the order of the best autoregression by what it makes of them.

    Those of few rows are mostly error, and the variance of a slow column adds up all their errors.

    Args:
        covariances: Of the channels, (C, K + 1).
        rows: How many each is the mean of.

    Source    [dHL97]
    """
    highest = covariances.shape[1] - 1
    moments = _toeplitz(covariances, highest)
    order = best_order(moments, rows, highest)
    coefficients = fit(moments, order)[:, ::-1]
    for lag in range(order + 1, highest + 1):
        before = covariances[:, lag - order : lag]
        covariances[:, lag] = (coefficients * before).sum(axis=1)


def _toeplitz(covariances: Array, order: int) -> Array:
    """Moments of autocovariances, (C, K + 1): (C, order + 1, order + 1)."""
    lag = np.arange(order + 1)
    return covariances[:, np.abs(np.subtract.outer(lag, lag))]


def _from_covariances(covariances: Array, order: int) -> Autoregression:
    """The autoregression of given autocovariances, (C, K + 1), by Yule and Walker."""
    moments = _toeplitz(covariances, order)
    coefficients = fit(moments, order)
    variance = innovation_variance(moments, coefficients)
    return Autoregression(coefficients, np.sqrt(np.maximum(variance, 0.0)))
