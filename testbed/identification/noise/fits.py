"""Fits under coloured noise, from products of rows with rows before them.

Channels whose rows have no gaps are whitened by the noise's own autoregression before they are
weighted: generalised least squares. Rows that were dropped, at a joint's reversals, break the
sequence: such channels are weighted only, and the covariance counts how residuals hang
together over neighbouring rows.

Columns of the products: the unknowns' columns, then the residuals, then ones where a row
counts. Rows come in units in which every channel's noise is about one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.identification.noise.autoregression import (
    HIGHEST,
    Autoregression,
    best_order,
    fit,
    unforetold,
)
from testbed.identification.noise.lagged_products import LaggedProducts
from testbed.identification.noise.scaled import scaled_inverse, scaled_solve

ROUNDS = 2
"""Times that noise and unknowns are found in turns."""

REWEIGHTINGS = 3
"""Times that the channels' weights are found anew from the residuals."""


ENOUGH = 2
"""Times as many rows as unknowns, of all channels together, that whitening has to leave."""

ROWS_PER_ORDER = 10
"""Rows that a coefficient of the noise has to be found from."""

LEAST = 1e-4
"""Least noise of a channel, in the units that rows come in: channels without noise are possible."""


LEAST_SHARE = 0.1
"""Of the variance that independent rows would give: sums over few lags can fall below zero."""


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """Unknowns under a noise that was found with them.

    Attributes:
        values: (m,).
        covariance: By the formula of the fit, (m, m).
        noise: Of the residuals.
    """

    values: Array
    covariance: Array
    noise: Autoregression


Fit = Callable[[LaggedProducts, int | None], NoiseFit]
"""A fit of products; the order of the noise is chosen where None is given."""


def whitened_fit(given: LaggedProducts, order: int | None = None) -> NoiseFit:
    """Generalised least squares: rows without gaps.

    Args:
        given: Products of unknowns' columns, residuals and ones.
        order: Of the noise; None for the best.
    """
    m = given.products.shape[2] - 2
    squares = given.products[0]
    values, _, _ = _weighted(squares, given.rows, m)
    if order is None:
        highest = _highest(given, m)
        order = highest and best_order(
            _moments(given, values, highest), given.after(highest), highest
        )
    for _ in range(ROUNDS):
        coefficients = fit(_moments(given, values, order), order)
        white = given.whitened(coefficients)
        values, inverse, spread = _weighted(white, given.after(order), m, order)
    return NoiseFit(values, inverse, Autoregression(coefficients, spread))


def weighted_fit(given: LaggedProducts, order: int | None = None) -> NoiseFit:
    """Weighted least squares, neighbouring residuals counted in the covariance: rows with gaps.

    Args:
        given: Products of unknowns' columns, residuals and ones.
        order: Of the noise; None for as many as there are lags.
    """
    m = given.products.shape[2] - 2
    counts = given.products[:, :, m + 1, m + 1]
    squares = given.products[0]
    used = np.maximum(counts[0], 1.0)
    values, inverse, spread = _weighted(squares, used, m)
    left = of_residuals(given.products, values)
    share = m / len(used)
    covariances = left / np.maximum(counts - share, 1.0)  # (K + 1, C)
    covariances[0] = spread**2  # which is not zero
    weights = 1 / spread**2
    parts = [
        np.tensordot(weights**2 * covariance, products[:, :m, :m], 1)
        for covariance, products in zip(covariances, given.products, strict=True)
    ]
    middle = parts[0] + sum(part + part.T for part in parts[1:])
    middle = _at_least(LEAST_SHARE, parts[0], middle)
    order = given.lags if order is None else order
    noise = _from_covariances(covariances, order)
    return NoiseFit(values, inverse @ middle @ inverse, noise)


def _highest(given: LaggedProducts, m: int) -> int:
    """Largest order that leaves rows enough for the unknowns, and for itself."""
    needed = ENOUGH * m // int(given.products.shape[1]) + 1
    return max(0, min(HIGHEST, given.lags, given.rows // ROWS_PER_ORDER, given.rows - needed))


def _at_least(share: float, least: Array, matrix: Array) -> Array:
    """A covariance that is nowhere below a share of another one."""
    root = np.linalg.cholesky(least)
    inverse = np.linalg.inv(root)
    spread, axes = np.linalg.eigh(inverse @ matrix @ inverse.T)
    half = root @ axes * np.sqrt(np.maximum(spread, share))
    return np.asarray(half @ half.T)


def _weighted(
    squares: Array, rows: Array | int, m: int, lost: int = 0
) -> tuple[Array, Array, Array]:
    """Values, inverse of the normal matrix, and noise of every channel.

    Args:
        squares: Products of the same rows, (C, q, q).
        rows: How many, (C,) or one number.
        m: Number of unknowns.
        lost: Rows' worth of freedom that a channel's noise model took.
    """
    free = np.maximum(rows - lost - m / len(squares), 1.0)
    spread = np.maximum(np.sqrt(np.maximum(squares[:, m, m], 0.0) / free), LEAST)
    for _ in range(REWEIGHTINGS):
        weights = 1 / spread**2
        normal = np.tensordot(weights, squares[:, :m, :m], 1)
        values = scaled_solve(normal, weights @ squares[:, :m, m])
        left = of_residuals(squares, values)
        spread = np.maximum(np.sqrt(np.maximum(left, 0.0) / free), LEAST)
    inverse = scaled_inverse(np.tensordot(1 / spread**2, squares[:, :m, :m], 1))
    return values, inverse, np.asarray(spread)


def _moments(given: LaggedProducts, values: Array, order: int) -> Array:
    """e_(t-i) e_(t-j) summed over t >= order, of the residuals e, (C, order + 1, order + 1)."""
    found = np.zeros((given.products.shape[1], order + 1, order + 1))
    combine = np.concatenate([-values, [1.0, 0.0]])
    left = given.combined(combine[:, None])
    for i in range(order + 1):
        for j in range(i, order + 1):
            found[:, i, j] = found[:, j, i] = left.shifted(i, j, order)[:, 0, 0]
    return found


def _from_covariances(covariances: Array, order: int) -> Autoregression:
    """The autoregression of given autocovariances, (K + 1, C), by Yule and Walker."""
    lag = np.abs(np.subtract.outer(np.arange(order + 1), np.arange(order + 1)))
    moments = covariances.T[:, lag]
    coefficients = fit(moments, order)
    left = unforetold(moments, coefficients)
    return Autoregression(coefficients, np.sqrt(np.maximum(left, 0.0)))


def of_residuals(products: Array, values: Array) -> Array:
    """Products of what values leave of the residuals, (...,).

    Args:
        products: Of columns, residuals and what follows them, (..., q, q).
        values: Of the columns' unknowns, (m,).
    """
    m, combine = len(values), np.append(-values, 1.0)
    part = products[..., : m + 1, : m + 1]
    return np.asarray(np.einsum("...ij,i,j->...", part, combine, combine))
