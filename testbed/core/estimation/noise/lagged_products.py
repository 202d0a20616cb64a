"""Lagged products of regression rows, the statistics of fits under coloured noise.

Whitened normal equations, the coefficients of the whitening autoregression, and the covariance of
an unwhitened fit are all sums of these products. A single pass over the rows is sufficient.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack

from testbed.core.base.arrays import Array
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE
from testbed.core.kernel.records import Ints

MAX_AUTOREGRESSION_ORDER = 6
"""Largest order and lag: 0.5 s at ten rows a second; longer memory shows in the slowest root."""

MAX_ROOT = 0.998
"""Largest root of an autoregression: fits that are unstable or nearly so are made stable."""


@dataclass(frozen=True, eq=False)
class Autoregression:
    """Autoregressive noise `e_t = sum over i of a_i e_(t-i) + u_t` of C channels.

    Attributes:
        coefficients: Coefficients a of order P, (C, P).
        sigma: Standard deviations of the innovations u, (C,).
    """

    coefficients: Array
    sigma: Array

    @property
    def order(self) -> int:
        """Order P of the autoregression."""
        return int(self.coefficients.shape[1])

    @property
    def decay_rows(self) -> Array:
        """Decay time of the slowest noise mode of each channel to 1/e, (C,) [rows]."""
        with np.errstate(divide="ignore"):  # white noise has none
            return np.asarray(-1 / np.log(_largest_roots(self.coefficients)))


def fit_autoregression(moments: Array, order: int) -> Array:
    """Fit coefficients of a stable autoregression by least squares, (..., P).

    Characteristic roots with magnitudes above MAX_ROOT are scaled down, with one factor for all
    roots of a channel.

    Args:
        moments: Sums of e_(t-i) e_(t-j) over the same t, (..., K + 1, K + 1), K >= P.
        order: Order P.
    """
    matrix, right = (
        moments[..., 1 : order + 1, 1 : order + 1],
        moments[..., 1 : order + 1, :1],
    )
    size = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None] / max(order, 1)
    # ridge relative to the mean square: exactly periodic noise has many autoregressions
    return _stable_coefficients(
        np.linalg.solve(
            matrix + (1e-12 * size + SMALLEST_POSITIVE) * np.eye(order), right
        )[..., 0]
    )


def whitening_filter(coefficients: Array) -> Array:
    """Coefficients of the whitening filter, 1, -a_1 ... -a_P, (..., P + 1)."""
    return np.concatenate(
        [np.ones((*coefficients.shape[:-1], 1)), -coefficients], axis=-1
    )


def innovation_variance(moments: Array, coefficients: Array) -> Array:
    """Sums of squared innovations u, in the scale of the moments, (...,).

    Args:
        moments: Moments as for `fit_autoregression`.
        coefficients: Coefficients of the autoregression, (..., P).
    """
    alpha, order = whitening_filter(coefficients), coefficients.shape[-1]
    part = moments[..., : order + 1, : order + 1]
    return np.asarray(np.einsum("...i,...ij,...j->...", alpha, part, alpha))


def best_order(
    moments: Array, rows: int, highest: int = MAX_AUTOREGRESSION_ORDER
) -> int:
    """Order from 1 to `highest` that minimises Akaike's criterion, common to all channels.

    Args:
        moments: Moments as for `fit_autoregression`, K >= highest.
        rows: Number of products in each sum.
        highest: Largest order to be tried.
    """
    scores = []
    for order in range(1, highest + 1):
        variance = np.maximum(
            innovation_variance(moments, fit_autoregression(moments, order)),
            SMALLEST_POSITIVE,
        )
        scores.append(rows * np.log(variance).sum() + 2 * order * len(moments))
    return 1 + int(np.argmin(scores))


def _largest_roots(coefficients: Array) -> Array:
    """Largest root magnitude of each autoregression, from its companion matrix, (...,)."""
    order = coefficients.shape[-1]
    companion = np.zeros((*coefficients.shape, order))
    companion[..., :1, :] = coefficients[..., None, :]
    companion[..., range(1, order), range(order - 1)] = 1.0
    return np.asarray(np.abs(np.linalg.eigvals(companion)).max(axis=-1, initial=0.0))


def _stable_coefficients(coefficients: Array) -> Array:
    """Coefficients with roots scaled to at most MAX_ROOT, (..., P)."""
    largest = np.maximum(_largest_roots(coefficients), MAX_ROOT)[..., None]
    powers = np.arange(1, coefficients.shape[-1] + 1)
    return coefficients * (MAX_ROOT / largest) ** powers


class NoiseGenerator:
    """Generator of replicas of autoregressive noise, block by block."""

    def __init__(
        self, noise: Autoregression, replicas: int, rng: np.random.Generator
    ) -> None:
        """Simulate rows before the first row, so that the noise is stationary.

        Args:
            noise: Autoregression to simulate.
            replicas: Number of replicas.
            rng: Random number generator.
        """
        self._noise, self._rng = noise, rng
        self._recent = np.zeros((len(noise.sigma), noise.order, replicas))
        # rows simulated before the first row
        self.rows(200)

    def rows(self, count: int) -> Array:
        """Simulate the next rows, (C, count, replicas)."""
        order, sigma = self._noise.order, self._noise.sigma
        innovations = (
            self._rng.normal(size=(count, len(sigma), self._recent.shape[2]))
            * sigma[:, None]
        )
        simulated = np.concatenate(
            [self._recent, innovations.transpose(1, 0, 2)], axis=1
        )
        for channel, alpha in enumerate(whitening_filter(self._noise.coefficients)):
            bands = np.repeat(alpha[:, None], order + count, axis=1)
            for lag in range(1, order + 1):
                bands[lag, : order - lag] = 0.0  # keep the earlier rows
            simulated[channel], _ = lapack.dtbtrs(
                bands, simulated[channel], uplo="L", diag="U"
            )
        self._recent = simulated[:, count:]
        return simulated[:, order:]


@dataclass(frozen=True, eq=False)
class LaggedProducts:
    """Lagged products of rows z_t of C channels and q columns, in S sequences.

    Fits interpret the columns as those of m unknowns, then R responses, then row indicators (one
    for rows that are used, else zero).

    Attributes:
        rows: Number of rows in all sequences.
        products: Sums of z_t z_(t-k)' over t >= k, for lags k = 0 ... K, (K + 1, C, q, q).
        first: First K rows of each sequence, (S, C, K, q); zeros where there are fewer.
        last: Last K rows of each sequence in chronological order, (S, C, K, q); zeros before its
            first row.
        responses: Number of responses, R.
    """

    rows: int
    products: Array
    first: Array
    last: Array
    responses: int = 1

    @property
    def lags(self) -> int:
        """Largest lag K."""
        return len(self.products) - 1

    @property
    def unknowns(self) -> int:
        """Number of columns before the responses, m."""
        return int(self.products.shape[2]) - self.responses - 1

    def rows_with_history(self, order: int) -> int:
        """Number of rows with at least `order` earlier rows in the same sequence.

        Args:
            order: Number of earlier rows.
        """
        return self.rows - order * len(self.first)

    @property
    def flat(self) -> Array:
        """Products as a matrix with a row per lag and channel, ((K + 1) C, q q)."""
        lags, channels, columns, _ = self.products.shape
        return self.products.reshape(lags * channels, columns**2)

    def with_max_lag(self, lag: int) -> LaggedProducts:
        """Products for lags up to a given maximum.

        Args:
            lag: Largest lag, at most K.
        """
        if lag == self.lags:
            return self
        first, last = self.first[:, :, :lag], self.last[:, :, self.lags - lag :]
        return replace(self, products=self.products[: lag + 1], first=first, last=last)

    def columns(self, indices: Ints) -> LaggedProducts:
        """Copy of the products of selected columns, in any order.

        Args:
            indices: Column indices.
        """
        products = self.products[..., indices[:, None], indices]
        first, last = self.first[..., indices], self.last[..., indices]
        return replace(self, products=products, first=first, last=last)

    def combine_columns(self, maps: Array) -> LaggedProducts:
        """Products of linear combinations of the columns.

        Args:
            maps: Matrices from a channel's columns to the combinations, (C, q, r), or (q, r) for
                all channels.
        """
        transposed = np.swapaxes(maps, -1, -2)
        products = np.asarray(transposed @ self.products @ maps)
        return replace(
            self, products=products, first=self.first @ maps, last=self.last @ maps
        )

    def sums(self, weights: Array) -> Array:
        """Weighted sums of the products over lags and channels, symmetrised, (R, q, q).

        Args:
            weights: Weights of channels and lags, (R, C, K + 1).
        """
        total = weights.swapaxes(1, 2).reshape(len(weights), -1) @ self.flat
        total = total.reshape(-1, *self.products.shape[2:])
        return np.asarray(total + total.swapaxes(1, 2)) / 2

    def traces(self, inner: Array) -> Array:
        """Traces of the products of each lag and channel times a matrix, (R, C, K + 1).

        Args:
            inner: Symmetric matrices, (R, q, q).
        """
        traces = inner.reshape(len(inner), -1) @ self.flat.T
        return traces.reshape(len(inner), *self.products.shape[:2]).swapaxes(1, 2)

    def squares(self, combinations: Array) -> Array:
        """Quadratic forms `b' A b` of the products A of each lag and channel, (R, C, K + 1).

        Args:
            combinations: Vectors b, (R, q).
        """
        squares = (self.products @ combinations.T) * combinations.T
        return np.asarray(squares.sum(axis=2).transpose(2, 1, 0))

    def moments(self, inner: Array, order: int) -> Array:
        """Lagged moments, sums of z_(t-i)' B z_(t-j) over t >= P, (R, C, P + 1, P + 1).

        Args:
            inner: Symmetric matrices B, (R, q, q).
            order: Order P, at most K.
        """
        lag, last = np.arange(order + 1), self.last[:, :, self.lags - order :]
        head, tail = (
            (_row_products(each[None], inner) @ each.swapaxes(2, 3)).sum(axis=1)
            for each in (self.first, last)
        )
        moments = self.traces(inner)[..., np.abs(np.subtract.outer(lag, lag))]
        # rows before t = P, and zeros after the last, do not count
        for t in range(order):
            moments[..., : t + 1, : t + 1] -= head[..., t::-1, t::-1]
            moments[..., t + 1 :, t + 1 :] -= tail[..., t:, t:][..., ::-1, ::-1]
        return moments

    def with_constants(self, directions: Array) -> LaggedProducts:
        """Products with columns of constants inserted after the unknowns' columns.

        In each channel, the column of a constant is the row indicator times the channel's
        component.

        Args:
            directions: Channel combinations with a constant offset, (C, k); for k = 0, the products
                are unchanged.
        """
        m, count, size = self.unknowns, directions.shape[1], self.products.shape[2]
        if not count:
            return self
        extended, constants = (
            self.columns(np.r_[:m, [size - 1] * count, m:size]),
            slice(m, m + count),
        )
        extended.products[..., constants, :] *= directions[:, :, None]
        for each in (extended.products, extended.first, extended.last):
            each[..., constants] *= directions[:, None]
        return extended


class WhitenedProducts:
    """Products of whitened rows e_t = z_t - sum of a_i z_(t-i), for R autoregressions.

    With alpha = (1, -a), they are the sum over lags k = 0 ... P of the lagged products times the
    sum of alpha_i alpha_(i+k), from which the products of e_t before t = P and after the last row,
    where z is zero, are subtracted. Only sums of whitened products are available, so that the
    lagged products are read once for all whitenings.
    """

    def __init__(self, products: LaggedProducts, coefficients: Array) -> None:
        """Compute the weights of the lags and the whitened rows at the ends of sequences.

        Args:
            products: Lagged products of the rows.
            coefficients: Coefficients a of each whitening and channel, (R, C, P), P at most K.
        """
        alpha, order = whitening_filter(coefficients), coefficients.shape[2]
        products, lag_weights = products.with_max_lag(order), np.empty(alpha.shape)
        for lag in range(order + 1):
            lag_weights[..., lag] = (
                alpha[..., lag:] * alpha[..., : order + 1 - lag]
            ).sum(axis=2)
        lag_weights[..., 1:] *= 2  # a lag's products, and their transpose
        self._products, self._lag_weights, self._edges = (
            products,
            lag_weights,
            _edge_rows(products, alpha),
        )
        if len(alpha) == 1:  # sum over the lags once
            whole = self.sums(np.eye(alpha.shape[1]))
            self._products = replace(products.with_max_lag(0), products=whole[None])
            self._lag_weights, self._edges = (
                np.ones((1, len(whole), 1)),
                self._edges[..., :0, :],
            )

    def sums(self, weights: Array) -> Array:
        """Weighted sums of the whitened products over channels, (R, q, q).

        Args:
            weights: Weights of the channels, (R, C).
        """
        whole = self._products.sums(weights[..., None] * self._lag_weights)
        edges = self._edges * np.sqrt(weights)[:, None, :, None, None]
        edges = edges.reshape(len(edges), -1, edges.shape[-1])
        return whole - edges.swapaxes(1, 2) @ edges

    def traces(self, inner: Array) -> Array:
        """Traces of each channel's whitened products times a matrix, (R, C).

        Args:
            inner: Symmetric matrices, (R, q, q).
        """
        edges = _row_products(self._edges, inner) * self._edges
        whole = (self._lag_weights * self._products.traces(inner)).sum(axis=2)
        return np.asarray(whole - edges.sum(axis=(1, 3, 4)))

    def squares(self, combinations: Array) -> Array:
        """Sum of squares of a combination of whitened columns in each channel, (R, C).

        Args:
            combinations: Combination of the columns for each whitening, (R, q).
        """
        edges = _row_products(self._edges, combinations[..., None])[..., 0]
        whole = (self._lag_weights * self._products.squares(combinations)).sum(axis=2)
        return np.asarray(whole - (edges**2).sum(axis=(1, 3)))


def _edge_rows(products: LaggedProducts, alpha: Array) -> Array:
    """Whitened rows before t = P and after the last row, (R, 2 S, C, P, q).

    Args:
        products: Lagged products up to lag P; rows outside of a sequence are taken as zero.
        alpha: Coefficients of the whitening filters, (R, C, P + 1).
    """
    order = alpha.shape[2] - 1
    before, after = np.zeros((2, len(alpha), *products.first.shape))
    for i in range(order + 1):
        coefficient = alpha[:, None, :, i, None, None]
        before[..., i:, :] += coefficient * products.first[:, :, : order - i]
        after[..., :i, :] += coefficient * products.last[:, :, order - i :]
    return np.concatenate([before, after], axis=1)


def _row_products(rows: Array, matrices: Array) -> Array:
    """Rows times the matrix of each response, in one matrix product, (R, S, C, k, r).

    Args:
        rows: Rows of each response, (R, S, C, k, q), or (1, S, C, k, q) where they are the same.
        matrices: Matrices, (R, q, r).
    """
    products = rows.reshape(len(rows), -1, rows.shape[-1]) @ matrices
    return products.reshape(len(matrices), *rows.shape[1:-1], matrices.shape[-1])


class LaggedSums:
    """Accumulator of lagged products over blocks of consecutive rows.

    In each channel, only columns with nonzero entries in or just before the block are multiplied.
    """

    def __init__(self, lags: int) -> None:
        """Start with zero sums.

        Args:
            lags: Largest lag K.
        """
        self._lags = lags
        self._rows = 0
        self._products: Array | None = None
        self._edges: list[tuple[Array, Array]] = []
        self._begin_sequence()

    def _begin_sequence(self) -> None:
        """Start an empty sequence."""
        self._sequence_rows = 0
        self._first: list[Array] = []
        self._recent: Array | None = None

    def add(self, block: Array) -> None:
        """Add a block of consecutive rows, (C, rows, q)."""
        channels, rows, width = block.shape
        if self._products is None:
            self._products = np.zeros((self._lags + 1, channels, width, width))
        if self._recent is None:
            self._recent = np.zeros((channels, self._lags, width))
        missing = self._lags - self._sequence_rows
        if missing > 0:
            self._first.append(block[:, :missing])
        extended = np.concatenate([self._recent, block], axis=1)
        for channel, each in enumerate(extended):
            used = each.any(axis=0).nonzero()[0]
            part = each[:, used]
            lagged = np.lib.stride_tricks.sliding_window_view(part, rows, axis=0)[::-1]
            for products, earlier in zip(
                self._products[:, channel], lagged, strict=True
            ):
                products[used[:, None], used] += part[self._lags :].T @ earlier.T
        self._rows += rows
        self._sequence_rows += rows
        self._recent = extended[:, rows:]

    def end_sequence(self) -> None:
        """End the sequence: the next rows do not follow the last row."""
        self._edges += self._current_edges()
        self._begin_sequence()

    def lagged_products(self) -> LaggedProducts:
        """Lagged products of all rows."""
        assert self._products is not None, "sums of no rows"
        first, last = zip(*self._edges, *self._current_edges(), strict=True)
        return LaggedProducts(
            self._rows, self._products, np.stack(first), np.stack(last)
        )

    def _current_edges(self) -> list[tuple[Array, Array]]:
        """First and last K rows of the current sequence, (C, K, q) each; empty without rows."""
        if self._recent is None:
            return []
        channels, _, columns = self._recent.shape
        first = np.concatenate([*self._first, np.zeros((channels, 0, columns))], axis=1)
        room = np.zeros((channels, self._lags - first.shape[1], columns))
        return [(np.concatenate([first, room], axis=1), self._recent)]
