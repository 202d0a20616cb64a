"""Fits under coloured noise, from products of rows with rows before them.

Channels whose rows have no gaps are whitened by the noise's own autoregression before they are
weighted: generalised least squares. Rows that were dropped, at a joint's reversals, break the
sequence: such channels are weighted only, and the covariance counts how residuals hang
together over neighbouring rows.

Residuals are not the noise: unknowns have taken a part of it, of each channel and at each
frequency another. Of generalised least squares the part is known, E r r' = E e e' - X G X' with G
the unknowns' covariance, and it is added: restricted maximum likelihood, in turns.

Columns of the products: the unknowns' columns, then the residuals, then ones where a row
counts. Rows come in units in which every channel's noise is about one.

Source    [PT71], [CR00] of autoregressions
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.arrays import Array
from testbed.blas import eigh
from testbed.identification.noise.autoregression import (
    HIGHEST,
    Autoregression,
    best_order,
    fit,
    unforetold,
)
from testbed.identification.noise.lagged_products import LaggedProducts
from testbed.identification.noise.scaled import inverse_root

ROUNDS = 4
"""Times that noise and unknowns are found in turns: what is left to go is 1 % of sigma."""

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
        white = given.whitened(self.weighting.coefficients)
        return np.asarray(np.tensordot(self.weighting.sigma**-2.0, white, 1))


Fit = Callable[[LaggedProducts, int | None], NoiseFit]
"""A fit of products; the order of the noise is chosen where None is given."""


def whitened_fit(given: LaggedProducts, order: int | None = None) -> NoiseFit:
    """Generalised least squares: rows without gaps.

    Args:
        given: Products of unknowns' columns, residuals and ones.
        order: Of the noise; None for the best.
    """
    m = given.products.shape[2] - 2
    found = _weighted(given.products[0], given.rows, m)
    if order is None:  # by residuals as they are: of coloured noise weights alone take less
        highest = _highest(given, m)
        left = given.moments(_of_residuals(found.values), highest)
        order = highest and best_order(left, given.after(highest), highest)
    for _ in range(ROUNDS if order else 1):
        coefficients = fit(_moments(given, found, order), order)
        white = given.whitened(coefficients)
        found = _weighted(white, given.after(order), m, order)
    noise = Autoregression(coefficients, found.spread)
    return NoiseFit(found.values, found.inverse, noise, noise, found.inverse)


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
    values, inverse, spread, taken = _weighted(squares, used, m)
    left = of_residuals(given.products, values)
    covariances = left / np.maximum(counts - taken, 1.0)  # (K + 1, C)
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
    weighting = Autoregression(np.zeros((len(spread), 0)), spread)
    return NoiseFit(values, inverse @ middle @ inverse, noise, weighting, inverse)


def _highest(given: LaggedProducts, m: int) -> int:
    """Largest order that leaves rows enough for the unknowns, and for itself."""
    needed = ENOUGH * m // int(given.products.shape[1]) + 1
    return max(0, min(HIGHEST, given.lags, given.rows // ROWS_PER_ORDER, given.rows - needed))


def _at_least(share: float, least: Array, matrix: Array) -> Array:
    """A covariance that is nowhere below a share of another one."""
    root = np.linalg.cholesky(least)
    inverse = np.linalg.inv(root)
    spread, axes = eigh(inverse @ matrix @ inverse.T)
    half = root @ axes * np.sqrt(np.maximum(spread, share))
    return np.asarray(half @ half.T)


class _Weighted(NamedTuple):
    """Weighted least squares, every channel by its own noise.

    Attributes:
        values: (m,).
        inverse: Of the normal matrix, (m, m).
        spread: Noise of every channel, (C,).
        taken: Rows' worth of each channel's noise that the unknowns have taken, (C,).
    """

    values: Array
    inverse: Array
    spread: Array
    taken: Array


def _weighted(squares: Array, rows: Array | int, m: int, lost: int = 0) -> _Weighted:
    """Unknowns and noise from products of the same rows.

    Args:
        squares: The products, (C, q, q).
        rows: How many, (C,) or one number.
        m: Number of unknowns.
        lost: Rows' worth of freedom that a channel's noise model took.
    """
    channels, taken = len(squares), np.full(len(squares), m / len(squares))
    columns = np.ascontiguousarray(squares[:, :m, :m]).reshape(channels, m * m)
    right, own = squares[:, :m, m], squares[:, m, m]
    left = np.maximum(own, 0.0)
    for _ in range(REWEIGHTINGS):
        spread = _spread(left, rows - lost - taken)
        root = inverse_root((spread**-2.0 @ columns).reshape(m, m))
        inverse, values = root @ root.T, root @ (root.T @ (spread**-2.0 @ right))
        taken = columns @ inverse.ravel() / spread**2
        explained = 2 * right @ values - columns @ np.outer(values, values).ravel()
        left = np.maximum(own - explained, 0.0)
    spread = _spread(left, rows - lost - taken)
    root = inverse_root((spread**-2.0 @ columns).reshape(m, m))
    return _Weighted(values, root @ root.T, spread, taken)


def _spread(left: Array, free: Array) -> Array:
    """Noise of every channel, of squares of residuals and degrees of freedom, (C,)."""
    return np.asarray(np.maximum(np.sqrt(left / np.maximum(free, 1.0)), LEAST))


def _moments(given: LaggedProducts, found: _Weighted, order: int) -> Array:
    """e_(t-i) e_(t-j) summed over t >= order, of the noise e, (C, order + 1, order + 1).

    Those of the residuals, what the unknowns have taken of the noise, and the least noise.
    """
    m, inner = len(found.values), _of_residuals(found.values)
    inner[:m, :m] += found.inverse
    least = LEAST**2 * given.after(order) * np.eye(order + 1)
    return given.moments(inner, order) + least


def _of_residuals(values: Array) -> Array:
    """B with z' B z the square of what values leave of a row z, (q, q)."""
    combine = np.concatenate([-values, [1.0, 0.0]])
    return np.outer(combine, combine)


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
