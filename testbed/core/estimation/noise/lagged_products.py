"""Products of rows with rows before them: all that a fit under coloured noise needs to know.

Whitening by an autoregression, its coefficients, the covariance of a fit that is not whitened:
each is another sum of these products. One look at the rows is enough, whatever their number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack

from testbed.core.base.arrays import Array
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.kernel.records import Ints

HIGHEST = 6
"""Largest order: half a second at ten rows a second; what lasts longer shows in the slowest."""

LARGEST_ROOT = 0.998
"""A fit may find noise that grows without end; it is held to one that forgets."""


@dataclass(frozen=True, eq=False)
class Autoregression:
    """Noise of C channels.

    Attributes:
        coefficients: a, (C, P).
        sigma: Standard deviations of u, (C,).
    """

    coefficients: Array
    sigma: Array

    @property
    def order(self) -> int:
        """P."""
        return int(self.coefficients.shape[1])

    @property
    def memory(self) -> Array:
        """Rows in which the slowest part of each channel's noise fades to 1/e, (C,)."""
        with np.errstate(divide="ignore"):  # white noise has none
            return np.asarray(-1 / np.log(_largest_roots(self.coefficients)))


def fit(moments: Array, order: int) -> Array:
    """Coefficients by least squares, (..., P), of noise that forgets.

    Args:
        moments: e_(t-i) e_(t-j) summed over the same t, (..., K + 1, K + 1), K >= P.
        order: P.
    """
    matrix, right = (
        moments[..., 1 : order + 1, 1 : order + 1],
        moments[..., 1 : order + 1, :1],
    )
    size = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None] / max(order, 1)
    # of the mean square: noise that repeats itself exactly has many autoregressions
    return _forgetting(
        np.linalg.solve(matrix + (1e-12 * size + TINY) * np.eye(order), right)[..., 0]
    )


def prediction_errors(coefficients: Array) -> Array:
    """1, -a_1 ... -a_P channel by channel, (..., P + 1): what makes white noise of the coloured."""
    return np.concatenate(
        [np.ones((*coefficients.shape[:-1], 1)), -coefficients], axis=-1
    )


def innovation_variance(moments: Array, coefficients: Array) -> Array:
    """Sums of the squares of u, (...,).

    Args:
        moments: As for `fit`.
        coefficients: (..., P).
    """
    alpha, order = prediction_errors(coefficients), coefficients.shape[-1]
    part = moments[..., : order + 1, : order + 1]
    return np.asarray(np.einsum("...i,...ij,...j->...", alpha, part, alpha))


def best_order(moments: Array, rows: int, highest: int = HIGHEST) -> int:
    """The order, 1 to `highest`, by Akaike's criterion, the same for all channels.

    Args:
        moments: As for `fit`, K >= highest.
        rows: How many products are in each sum.
        highest: The largest to be tried.
    """
    scores = []
    for order in range(1, highest + 1):
        variance = np.maximum(innovation_variance(moments, fit(moments, order)), TINY)
        scores.append(rows * np.log(variance).sum() + 2 * order * len(moments))
    return 1 + int(np.argmin(scores))


def _largest_roots(coefficients: Array) -> Array:
    """How much of each channel's noise the slowest part of it keeps from row to row, (...,)."""
    order = coefficients.shape[-1]
    companion = np.zeros((*coefficients.shape, order))
    companion[..., :1, :] = coefficients[..., None, :]
    companion[..., range(1, order), range(order - 1)] = 1.0
    return np.asarray(np.abs(np.linalg.eigvals(companion)).max(axis=-1, initial=0.0))


def _forgetting(coefficients: Array) -> Array:
    """The same, with roots inside the unit circle, (..., P)."""
    largest = np.maximum(_largest_roots(coefficients), LARGEST_ROOT)[..., None]
    powers = np.arange(1, coefficients.shape[-1] + 1)
    return coefficients * (LARGEST_ROOT / largest) ** powers


class NoiseMaker:
    """Replicas of noise, row after row."""

    def __init__(
        self, noise: Autoregression, replicas: int, rng: np.random.Generator
    ) -> None:
        """Ready for the first row.

        Args:
            noise: What to make.
            replicas: How many at a time.
            rng: Random numbers.
        """
        self._noise, self._rng = noise, rng
        self._recent = np.zeros((len(noise.sigma), noise.order, replicas))
        # rows simulated before the first that counts
        self.rows(200)

    def rows(self, count: int) -> Array:
        """The next rows, (C, count, replicas)."""
        order, sigma = self._noise.order, self._noise.sigma
        fresh = (
            self._rng.normal(size=(count, len(sigma), self._recent.shape[2]))
            * sigma[:, None]
        )
        made = np.concatenate([self._recent, fresh.transpose(1, 0, 2)], axis=1)
        for channel, alpha in enumerate(prediction_errors(self._noise.coefficients)):
            bands = np.repeat(alpha[:, None], order + count, axis=1)
            for back in range(1, order + 1):
                bands[back, : order - back] = 0.0  # what is made already stays
            made[channel], _ = lapack.dtbtrs(bands, made[channel], uplo="L", diag="U")
        self._recent = made[:, count:]
        return made[:, order:]


@dataclass(frozen=True, eq=False)
class LaggedProducts:
    """Sums over rows z_t of C channels with q columns each, in one sequence or S apart.

    A fit takes the columns for those of m unknowns, then R responses, then ones.

    Attributes:
        rows: How many, of all sequences.
        products: By lag k = 0 ... K: z_t z_(t-k)' summed over t >= k, (K + 1, C, q, q).
        first: The first K rows of each sequence, (S, C, K, q); zeros where there are fewer.
        last: The last K, in the order of time, (S, C, K, q); zeros before the first.
        responses: R.
    """

    rows: int
    products: Array
    first: Array
    last: Array
    responses: int = 1

    @property
    def lags(self) -> int:
        """The largest lag K."""
        return len(self.products) - 1

    @property
    def unknowns(self) -> int:
        """Columns before the responses, m."""
        return int(self.products.shape[2]) - self.responses - 1

    def after(self, order: int) -> int:
        """Rows with so many rows before.

        Args:
            order: How many.
        """
        return self.rows - order * len(self.first)

    @property
    def flat(self) -> Array:
        """Products lag by lag, channel by channel, ((K + 1) C, q q)."""
        lags, channels, columns, _ = self.products.shape
        return self.products.reshape(lags * channels, columns**2)

    def up_to(self, lag: int) -> LaggedProducts:
        """Of fewer lags.

        Args:
            lag: The largest, at most K.
        """
        if lag == self.lags:
            return self
        first, last = self.first[:, :, :lag], self.last[:, :, self.lags - lag :]
        return replace(self, products=self.products[: lag + 1], first=first, last=last)

    def columns(self, which: Ints) -> LaggedProducts:
        """Copy of some of the columns, in any order.

        Args:
            which: Their numbers.
        """
        products = self.products[..., which[:, None], which]
        first, last = self.first[..., which], self.last[..., which]
        return replace(self, products=products, first=first, last=last)

    def combined(self, maps: Array) -> LaggedProducts:
        """Of combinations of the columns.

        Args:
            maps: How a channel's columns make up the new ones, (C, q, r), or (q, r) for all.
        """
        back = np.swapaxes(maps, -1, -2)
        products = np.asarray(back @ self.products @ maps)
        return replace(
            self, products=products, first=self.first @ maps, last=self.last @ maps
        )

    def sums(self, weights: Array) -> Array:
        """Of all lags and channels, half of what they are and of their transpose, (R, q, q).

        Args:
            weights: Of channels and lags, (R, C, K + 1).
        """
        total = weights.swapaxes(1, 2).reshape(len(weights), -1) @ self.flat
        total = total.reshape(-1, *self.products.shape[2:])
        return np.asarray(total + total.swapaxes(1, 2)) / 2

    def traces(self, inner: Array) -> Array:
        """Traces of each lag's times a matrix, (R, C, K + 1).

        Args:
            inner: The matrices, symmetric, (R, q, q).
        """
        traces = inner.reshape(len(inner), -1) @ self.flat.T
        return traces.reshape(len(inner), *self.products.shape[:2]).swapaxes(1, 2)

    def squares(self, combinations: Array) -> Array:
        """B' of each lag's products b, (R, C, K + 1).

        Args:
            combinations: Each b, (R, q).
        """
        squares = (self.products @ combinations.T) * combinations.T
        return np.asarray(squares.sum(axis=2).transpose(2, 1, 0))

    def moments(self, inner: Array, order: int) -> Array:
        """z_(t-i)' B z_(t-j) summed over t >= P, (R, C, P + 1, P + 1).

        Args:
            inner: Each B, symmetric, (R, q, q).
            order: P, at most K.
        """
        lag, last = np.arange(order + 1), self.last[:, :, self.lags - order :]
        head, tail = (
            (_times(each[None], inner) @ each.swapaxes(2, 3)).sum(axis=1)
            for each in (self.first, last)
        )
        moments = self.traces(inner)[..., np.abs(np.subtract.outer(lag, lag))]
        # rows before t = P, and zeros after the last, do not count
        for t in range(order):
            moments[..., : t + 1, : t + 1] -= head[..., t::-1, t::-1]
            moments[..., t + 1 :, t + 1 :] -= tail[..., t:, t:][..., ::-1, ::-1]
        return moments

    def with_constants(self, directions: Array) -> LaggedProducts:
        """With constants after the unknowns' columns.

        Args:
            directions: Combinations of the channels, (C, k).
        """
        m, count, size = self.unknowns, directions.shape[1], self.products.shape[2]
        if not count:
            return self
        extended, own = (
            self.columns(np.r_[:m, [size - 1] * count, m:size]),
            slice(m, m + count),
        )
        extended.products[..., own, :] *= directions[:, :, None]
        for each in (extended.products, extended.first, extended.last):
            each[..., own] *= directions[:, None]
        return extended


class Whitened:
    """Products of rows e_t = z_t - sum over i of a_i z_(t-i), t >= P, for each of R whitenings.

    With alpha = (1, -a), they are the products of lag k = 0 ... P times the sum of
    alpha_i alpha_(i+k), less those of e_t before t = P and after the last row, zeros there. Only
    sums of them are asked for, so that products are read once for all whitenings.
    """

    def __init__(self, given: LaggedProducts, coefficients: Array) -> None:
        """Ready.

        Args:
            given: Products of the rows.
            coefficients: a of each whitening, channel by channel, (R, C, P), P at most K.
        """
        alpha, order = prediction_errors(coefficients), coefficients.shape[2]
        given, share = given.up_to(order), np.empty(alpha.shape)
        for lag in range(order + 1):
            share[..., lag] = (alpha[..., lag:] * alpha[..., : order + 1 - lag]).sum(
                axis=2
            )
        share[..., 1:] *= 2  # a lag's products, and their transpose
        self._given, self._share, self._edges = given, share, _edges(given, alpha)
        if len(alpha) == 1:  # then once and for all
            whole = self.sums(np.eye(alpha.shape[1]))
            self._given = replace(given.up_to(0), products=whole[None])
            self._share, self._edges = (
                np.ones((1, len(whole), 1)),
                self._edges[..., :0, :],
            )

    def sums(self, weights: Array) -> Array:
        """Of all channels, (R, q, q).

        Args:
            weights: Of the channels, (R, C).
        """
        whole = self._given.sums(weights[..., None] * self._share)
        edges = self._edges * np.sqrt(weights)[:, None, :, None, None]
        edges = edges.reshape(len(edges), -1, edges.shape[-1])
        return whole - edges.swapaxes(1, 2) @ edges

    def traces(self, inner: Array) -> Array:
        """Traces of each channel's times a matrix, (R, C).

        Args:
            inner: The matrices, symmetric, (R, q, q).
        """
        edges = _times(self._edges, inner) * self._edges
        whole = (self._share * self._given.traces(inner)).sum(axis=2)
        return np.asarray(whole - edges.sum(axis=(1, 3, 4)))

    def squares(self, combinations: Array) -> Array:
        """Of one combination of the columns for each whitening, channel by channel, (R, C).

        Args:
            combinations: (R, q).
        """
        edges = _times(self._edges, combinations[..., None])[..., 0]
        whole = (self._share * self._given.squares(combinations)).sum(axis=2)
        return np.asarray(whole - (edges**2).sum(axis=(1, 3)))


def _edges(given: LaggedProducts, alpha: Array) -> Array:
    """e_t before t = P and after the last row, zeros there, (R, 2 S, C, P, q)."""
    order = alpha.shape[2] - 1
    before, after = np.zeros((2, len(alpha), *given.first.shape))
    for i in range(order + 1):
        share = alpha[:, None, :, i, None, None]
        before[..., i:, :] += share * given.first[:, :, : order - i]
        after[..., :i, :] += share * given.last[:, :, order - i :]
    return np.concatenate([before, after], axis=1)


def _times(rows: Array, matrices: Array) -> Array:
    """Each response's rows times its matrix: one product for all of them, (R, S, C, k, r).

    Args:
        rows: (R, S, C, k, q), or (1, S, C, k, q) where they are the same.
        matrices: (R, q, r).
    """
    products = rows.reshape(len(rows), -1, rows.shape[-1]) @ matrices
    return products.reshape(len(matrices), *rows.shape[1:-1], matrices.shape[-1])


class LaggedSums:
    """Adds up products of rows as they come, of each channel's columns from the first in use on."""

    def __init__(self, lags: int) -> None:
        """Nothing yet.

        Args:
            lags: The largest lag K.
        """
        self._lags = lags
        self._rows = 0
        self._products: Array | None = None
        self._edges: list[tuple[Array, Array]] = []
        self._begin()

    def _begin(self) -> None:
        """A sequence without rows."""
        self._since = 0
        self._first: list[Array] = []
        self._recent: Array | None = None

    def add(self, block: Array) -> None:
        """Go on with consecutive rows, (C, rows, q)."""
        channels, rows, width = block.shape
        if self._products is None:
            self._products = np.zeros((self._lags + 1, channels, width, width))
        if self._recent is None:
            self._recent = np.zeros((channels, self._lags, width))
        missing = self._lags - self._since
        if missing > 0:
            self._first.append(block[:, :missing])
        run = np.concatenate([self._recent, block], axis=1)
        for channel, each in enumerate(run):
            used = each.any(axis=0).nonzero()[0]
            part = each[:, used]
            before = np.lib.stride_tricks.sliding_window_view(part, rows, axis=0)[::-1]
            for products, then in zip(self._products[:, channel], before, strict=True):
                products[used[:, None], used] += part[self._lags :].T @ then.T
        self._rows += rows
        self._since += rows
        self._recent = run[:, rows:]

    def pause(self) -> None:
        """What comes next does not follow what came last."""
        self._edges += self._open()
        self._begin()

    def finish(self) -> LaggedProducts:
        """The sums."""
        assert self._products is not None, "sums of no rows"
        first, last = zip(*self._edges, *self._open(), strict=True)
        return LaggedProducts(
            self._rows, self._products, np.stack(first), np.stack(last)
        )

    def _open(self) -> list[tuple[Array, Array]]:
        """First and last rows of the sequence that is not closed, if it has any."""
        if self._recent is None:
            return []
        channels, _, columns = self._recent.shape
        first = np.concatenate([*self._first, np.zeros((channels, 0, columns))], axis=1)
        room = np.zeros((channels, self._lags - first.shape[1], columns))
        return [(np.concatenate([first, room], axis=1), self._recent)]
