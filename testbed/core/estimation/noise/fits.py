"""Weighted and generalised least squares under coloured noise, from lagged products.

Channels whose rows have no gaps are whitened by an autoregression of their noise before they are
weighted (generalised least squares). Rows dropped at the velocity reversals of a joint break the
sequence: such channels are only weighted, and the covariance accounts for the autocovariance of
their residuals.

Residuals are smaller than the noise, because the unknowns fit a part of it. In generalised least
squares this part is known, E r r' = E e e' - X G X', where G is the covariance of the unknowns, and
it is added back in each iteration (restricted maximum likelihood). For rows with gaps, it is added
at each lag as if their noise were white.

The columns of the products are those of the unknowns, then the residuals, then row indicators (one
for rows that are used). Rows are scaled so that the noise of every channel is about one. R
responses with the same columns, such as replicas of noise, are fitted in parallel, each with its
own noise.

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
    MAX_AUTOREGRESSION_ORDER,
    Autoregression,
    LaggedProducts,
    WhitenedProducts,
    best_order,
    fit_autoregression,
    innovation_variance,
)
from testbed.core.estimation.regression.normal_equations import inverse_and_solution

MIN_SIGMA = 1e-4
"""Smallest sigma of a channel, in the units of the rows: channels without noise are possible."""


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """Least-squares estimate of the unknowns, and the noise estimated with it.

    Attributes:
        values: Unknowns, (m,).
        covariance: Formal covariance of the fit, (m, m).
        noise: Autoregression of the residuals.
        weighting: Autoregression that whitened and weighted the rows; order zero for rows with
            gaps.
        inverse: Inverse of the normal matrix of the weighted rows, (m, m).
    """

    values: Array
    covariance: Array
    noise: Autoregression
    weighting: Autoregression
    inverse: Array

    def normal(self, products: LaggedProducts) -> Array:
        """Normal matrix of other columns, weighted as in this fit, (q, q).

        Args:
            products: Lagged products of the columns.
        """
        white = WhitenedProducts(products, self.weighting.coefficients[None])
        return np.asarray(white.sums(self.weighting.sigma[None] ** -2.0)[0])


FitFunction = Callable[[LaggedProducts, int | None], list[NoiseFit]]
"""Function that fits each response; the order of the noise is chosen where None is given."""


def whitened_fits(products: LaggedProducts, order: int | None = None) -> list[NoiseFit]:
    """Generalised least squares for rows without gaps, one fit per response.

    Noise and unknowns are estimated in turn, in four iterations, by restricted maximum likelihood.

    Args:
        products: Lagged products of the unknowns' columns, residuals and row indicators.
        order: Order of the autoregression; None to minimise Akaike's criterion for the first
            response.
    """
    unlagged = products.with_max_lag(0)
    weighted = _reweighted_least_squares(unlagged, products.rows)
    # from uncorrected residuals: weighting alone fits less of coloured noise
    if order is None:
        max_order = _max_order(products, unlagged.unknowns)
        residual_products = _outer_products(
            _residual_combinations(unlagged, weighted.values)
        )
        moments = products.moments(residual_products, max_order)[0]
        order = max_order and best_order(
            moments, products.rows_with_history(max_order), max_order
        )
    products = products.with_max_lag(order)
    # iterations of noise and unknowns: they converge to 1 % of sigma
    for _ in range(4 if order else 1):
        coefficients = fit_autoregression(
            _noise_moments(products, weighted, order), order
        )
        weighted = _reweighted_least_squares(
            products, products.rows_with_history(order), coefficients
        )
    noises = map(Autoregression, coefficients, weighted.sigma)
    solutions = zip(weighted.values, weighted.inverse, noises, strict=True)
    return [
        NoiseFit(values, inverse, noise, noise, inverse)
        for values, inverse, noise in solutions
    ]


def weighted_fits(products: LaggedProducts, order: int | None = None) -> list[NoiseFit]:
    """Weighted least squares for rows with gaps, one fit per response.

    The covariance accounts for the autocovariance of the residuals (sandwich formula) and is at
    least a tenth of that under white noise. Autocovariances at high lags are extrapolated.

    Args:
        products: Lagged products of the unknowns' columns, residuals and row indicators.
        order: Order of the returned autoregression, which does not affect values and covariance;
            None for the largest lag.
    """
    m, unlagged = products.unknowns, products.with_max_lag(0)
    counts = products.products[:, :, -1, -1].T  # (C, K + 1)
    weighted = _reweighted_least_squares(unlagged, np.maximum(counts[:, 0], 1.0))
    covariances = products.traces(_noise_forms(products, weighted))
    covariances /= np.maximum(counts, 1.0)  # (R, C, K + 1)
    covariances[..., 0] = weighted.sigma**2  # which is not zero
    for each in covariances:
        _extrapolate_autocovariances(each, int(np.mean(counts[:, 0])))
    weights = weighted.sigma[..., None] ** -4.0 * covariances
    independent = unlagged.sums(weights[..., :1])
    weights[..., 1:] *= 2  # a lag's products, and their transpose
    correlated = products.sums(weights)
    fits = []
    for r, inverse in enumerate(weighted.inverse):
        # at least a tenth of the variance under white noise: sums over few lags can be negative
        correlated_part = _raised_covariance(
            0.1, independent[r, :m, :m], correlated[r, :m, :m]
        )
        noise = _yule_walker(covariances[r], products.lags if order is None else order)
        weighting = Autoregression(np.zeros((len(counts), 0)), weighted.sigma[r])
        fits.append(
            NoiseFit(
                weighted.values[r],
                inverse @ correlated_part @ inverse,
                noise,
                weighting,
                inverse,
            )
        )
    return fits


def _max_order(products: LaggedProducts, unknowns: int) -> int:
    """Largest order that leaves enough rows for unknowns and coefficients.

    The order leaves at least ten rows per lag and, after whitening, two rows (over all channels)
    per unknown.

    Args:
        products: Lagged products.
        unknowns: Number of unknowns, m.
    """
    # whitening has to leave twice as many rows, of all channels together, as unknowns
    needed = 2 * unknowns // int(products.products.shape[1]) + 1
    # ten rows for each coefficient of the noise
    return max(
        0,
        min(
            MAX_AUTOREGRESSION_ORDER,
            products.lags,
            products.rows // 10,
            products.rows - needed,
        ),
    )


def _raised_covariance(share: float, reference: Array, matrix: Array) -> Array:
    """Covariance raised to at least a fraction of a reference in every direction.

    Args:
        share: Smallest ratio of variances.
        reference: Covariance to compare with, (m, m).
        matrix: Covariance to be raised, (m, m).
    """
    root = np.linalg.cholesky(reference)
    inverse = np.linalg.inv(root)
    ratios, axes = eigh(inverse @ matrix @ inverse.T)
    half = root @ axes * np.sqrt(np.maximum(ratios, share))
    return half @ half.T


class _WeightedSolutions(NamedTuple):
    """Weighted least-squares solutions of R responses, with channel noise.

    Attributes:
        values: Unknowns, (R, m).
        inverse: Inverses of the normal matrices, (R, m, m).
        sigma: Standard deviation of every channel's noise, (R, C).
        freedom: Degrees of freedom that the unknowns use in each channel, (R, C).
    """

    values: Array
    inverse: Array
    sigma: Array
    freedom: Array


def _reweighted_least_squares(
    products: LaggedProducts,
    rows: Array | int,
    coefficients: Array | None = None,
) -> _WeightedSolutions:
    """Weighted least-squares solutions, with channel weights by iterative reweighting.

    Weights are inverse residual variances, which are computed per degree of freedom in three
    iterations.

    Args:
        products: Lagged products.
        rows: Number of rows, (C,) or the same for all channels.
        coefficients: Coefficients of the whitening autoregressions of order P, (R, C, P); None for
            no whitening.
    """
    m, trials, channels = (
        products.unknowns,
        products.responses,
        products.products.shape[1],
    )
    if coefficients is None:
        coefficients = np.zeros((trials, channels, 0))
    white, free = (
        WhitenedProducts(products, coefficients),
        np.asarray(rows) - coefficients.shape[2],
    )
    values, freedom = np.zeros((trials, m)), np.full((trials, channels), m / channels)
    inverses = np.zeros((trials, *products.products.shape[2:]))
    sigma = _sigmas(
        white.squares(_residual_combinations(products, values)), free - freedom
    )
    # iterations of the channels' weights
    for _ in range(3):
        inverses[:, :m, :m], values = _normal_solutions(white.sums(sigma**-2.0), m)
        freedom = white.traces(inverses) / sigma**2
        sigma = _sigmas(
            white.squares(_residual_combinations(products, values)), free - freedom
        )
    inverse, _ = _normal_solutions(white.sums(sigma**-2.0), m)
    return _WeightedSolutions(values, inverse, sigma, freedom)


def _normal_solutions(sums: Array, m: int) -> tuple[Array, Array]:
    """Inverses of the normal matrices, (R, m, m), and each response's solution, (R, m).

    Args:
        sums: Products of the columns of unknowns, R responses and indicators, (R, q, q).
        m: Number of unknowns.
    """
    solutions = [
        inverse_and_solution(matrix[:m, :m], matrix[:m, m + r])
        for r, matrix in enumerate(sums)
    ]
    inverses, values = zip(*solutions, strict=True)
    return np.stack(inverses), np.stack(values)


def _sigmas(squares: Array, free: Array) -> Array:
    """Standard deviations from squared residuals and degrees of freedom, at least MIN_SIGMA."""
    return np.maximum(
        np.sqrt(np.maximum(squares, 0.0) / np.maximum(free, 1.0)), MIN_SIGMA
    )


def _noise_moments(
    products: LaggedProducts, weighted: _WeightedSolutions, order: int
) -> Array:
    """Moments of the noise, sums of e_(t-i) e_(t-j), (R, C, P + 1, P + 1).

    Sums are over t >= P, where P is the order. The part of the noise that the unknowns fit is added
    back (`_noise_forms`).
    """
    floor = MIN_SIGMA**2 * products.rows_with_history(order) * np.eye(order + 1)
    return products.moments(_noise_forms(products, weighted), order) + floor


def _noise_forms(products: LaggedProducts, weighted: _WeightedSolutions) -> Array:
    """Quadratic form in the columns of a row that gives the expected squared noise, (R, q, q).

    It is b b', where b is the column combination of the residual, plus the covariance of the
    unknowns, which adds back the part of the noise that the unknowns fit.
    """
    m, forms = (
        products.unknowns,
        _outer_products(_residual_combinations(products, weighted.values)),
    )
    forms[:, :m, :m] += weighted.inverse
    return forms


def _residual_combinations(products: LaggedProducts, values: Array) -> Array:
    """Column combinations b that give the residual b' z of a row z, (R, q)."""
    trials, m = values.shape
    combinations = np.zeros((trials, products.products.shape[2]))
    combinations[:, :m], combinations[range(trials), range(m, m + trials)] = (
        -values,
        1.0,
    )
    return combinations


def _outer_products(combinations: Array) -> Array:
    """Outer products b b' of each vector b, (R, q, q)."""
    return combinations[:, :, None] * combinations[:, None, :]


def _extrapolate_autocovariances(covariances: Array, rows: int) -> None:
    """Replace autocovariances at high lags by values from an autoregression, in place.

    The order of the autoregression minimises Akaike's criterion, and high lags are those beyond
    this order. Sample autocovariances at high lags are mostly estimation error, which accumulates
    in the variance of slowly varying columns.

    Args:
        covariances: Autocovariances of the channels, (C, K + 1).
        rows: Number of rows in each mean.

    Source    [dHL97]
    """
    highest = covariances.shape[1] - 1
    moments = _toeplitz(covariances, highest)
    order = best_order(moments, rows, highest)
    coefficients = fit_autoregression(moments, order)[:, ::-1]
    for lag in range(order + 1, highest + 1):
        recent = covariances[:, lag - order : lag]
        covariances[:, lag] = (coefficients * recent).sum(axis=1)


def _toeplitz(covariances: Array, order: int) -> Array:
    """Toeplitz matrices of autocovariances, (C, order + 1, order + 1).

    Args:
        covariances: Autocovariances of the channels, (C, K + 1).
        order: Largest lag in the matrices.
    """
    lag = np.arange(order + 1)
    return covariances[:, np.abs(np.subtract.outer(lag, lag))]


def _yule_walker(covariances: Array, order: int) -> Autoregression:
    """Autoregression with given autocovariances, (C, K + 1), from the Yule-Walker equations."""
    moments = _toeplitz(covariances, order)
    coefficients = fit_autoregression(moments, order)
    variance = innovation_variance(moments, coefficients)
    return Autoregression(coefficients, np.sqrt(np.maximum(variance, 0.0)))
