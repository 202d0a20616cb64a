"""Products of rows with rows before them: all that a fit under coloured noise needs to know.

Whitening by an autoregression, its coefficients, the covariance of a fit that is not whitened:
each is another sum of these products. One look at the rows is enough, whatever their number.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from testbed.arrays import Array
from testbed.identification.noise.autoregression import prediction_errors


@dataclass(frozen=True, eq=False)
class LaggedProducts:
    """Sums over rows z_t of C channels with q columns each, in one sequence or S apart.

    Attributes:
        rows: How many, of all sequences.
        products: By lag k = 0 ... K: z_t z_(t-k)' summed over t >= k, (K + 1, C, q, q).
        first: The first K rows of each sequence, (S, C, K, q); zeros where there are fewer.
        last: The last K, in the order of time, (S, C, K, q); zeros before the first.
    """

    rows: int
    products: Array
    first: Array
    last: Array

    @property
    def lags(self) -> int:
        """The largest lag K."""
        return len(self.products) - 1

    def after(self, order: int) -> int:
        """Rows with so many rows before.

        Args:
            order: How many.
        """
        return self.rows - order * len(self.first)

    @cached_property
    def symmetric(self) -> Array:
        """Half of each lag's products and of their transpose, (C, K + 1, q q)."""
        lags, channels, columns, _ = self.products.shape
        found = np.empty((channels, lags, columns, columns))
        for lag, each in enumerate(self.products):
            np.add(each / 2, each.swapaxes(1, 2) / 2, out=found[:, lag])
        return found.reshape(channels, lags, -1)

    @property
    def at_once(self) -> LaggedProducts:
        """Without rows before."""
        none = self.first[:, :, :0]
        return LaggedProducts(self.rows, self.products[:1], none, none)

    def picked(self, which: list[int]) -> LaggedProducts:
        """Of some of the columns alone.

        Args:
            which: Their places, in the order that is wanted.
        """
        products = self.products[:, :, which][..., which]
        return LaggedProducts(self.rows, products, self.first[..., which], self.last[..., which])

    def leading(self, count: int) -> LaggedProducts:
        """Of the first columns, and of the last two.

        Args:
            count: How many come first.
        """
        columns = self.products.shape[2]
        return self.picked([*range(count), columns - 2, columns - 1])

    def combined(self, maps: Array) -> LaggedProducts:
        """Of combinations of the columns.

        Args:
            maps: How a channel's columns make up the new ones, (C, q, r), or (q, r) for all.
        """
        back = np.swapaxes(maps, -1, -2)
        return LaggedProducts(
            self.rows,
            np.asarray(back @ self.products @ maps),
            self.first @ maps,
            self.last @ maps,
        )

    def moments(self, inner: Array, order: int) -> Array:
        """z_(t-i)' B z_(t-j) summed over t >= P, (C, P + 1, P + 1).

        Args:
            inner: B, symmetric, (q, q).
            order: P, at most K.
        """
        whole = (self.symmetric[:, : order + 1] @ inner.ravel()).T
        first, last = (each @ inner @ each.swapaxes(2, 3) for each in (self.first, self.last))
        found, size = np.zeros((len(whole[0]), order + 1, order + 1)), self.last.shape[2]
        for i in range(order + 1):
            for j in range(i, order + 1):
                lag = j - i  # rows before t = P, and those after the last t - i, do not count
                head = first[:, :, lag : order - i, : order - i - lag]
                tail = last[:, :, size - i :, size - i - lag : size - lag]
                edges = sum(np.trace(e, axis1=2, axis2=3).sum(axis=0) for e in (head, tail))
                found[:, i, j] = found[:, j, i] = whole[lag] - edges
        return found

    def whitened(self, coefficients: Array) -> Array:
        """e_t e_t' of e_t = z_t - sum over i of a_i z_(t-i), over t >= P, (C, q, q).

        Args:
            coefficients: a, channel by channel, (C, P), P at most K.
        """
        alpha, order = prediction_errors(coefficients), coefficients.shape[1]
        share = np.stack(  # of all t, as if zeros stood before and after the rows
            [(alpha[:, lag:] * alpha[:, : order + 1 - lag]).sum(axis=1) for lag in range(order + 1)]
        )
        share[1:] *= 2  # a lag's products, and their transpose
        total = share.T[:, None] @ self.symmetric[:, : order + 1]
        total = total.reshape(self.products.shape[1:])
        edges = self._edges(alpha)
        total -= _together(edges, edges)
        return total

    def _edges(self, alpha: Array) -> Array:
        """e_t before t = P and after the last row, zeros there, (S, C, 2 P, q)."""
        order, size = alpha.shape[1] - 1, self.last.shape[2]
        sequences, channels, _, columns = self.first.shape
        found = np.zeros((sequences, channels, 2 * order, columns))
        for i in range(order + 1):
            share = alpha[:, i, None, None]
            found[:, :, i:order] += share * self.first[:, :, : order - i]
            found[:, :, order : order + i] += share * self.last[:, :, size - i :]
        return found

    def carrying(self, maps: Array) -> LaggedProducts:
        """Of combinations of the first columns and the last, the others left as they are.

        Args:
            maps: How the first m columns and the last one make up the first r new ones,
                (C, m + 1, r).
        """
        channels, m, r = len(maps), maps.shape[1] - 1, maps.shape[2]
        kept = self.products.shape[2] - m
        whole = np.zeros((channels, m + kept, r + kept))
        whole[:, :m, :r], whole[:, -1, :r] = maps[:, :m], maps[:, m]
        whole[:, m:, r:] = np.eye(kept)
        return self.combined(whole)


@dataclass(frozen=True, eq=False)
class SymmetricProducts(LaggedProducts):
    """Products of which those of a lag are symmetric, (C, K + 1, q, q) in memory."""

    @property
    def symmetric(self) -> Array:
        """As they are, (C, K + 1, q q)."""
        whole = self.products.swapaxes(0, 1)
        return whole.reshape(*whole.shape[:2], -1)


def _together(now: Array, before: Array) -> Array:
    """Products of rows with rows, over all of them and all sequences, (C, q, q)."""
    return np.asarray(np.matmul(now.swapaxes(-1, -2), before).sum(axis=0))


class LaggedSums:
    """Adds up products of rows as they come."""

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
        channels, rows, columns = block.shape
        if self._products is None:
            self._products = np.zeros((self._lags + 1, channels, columns, columns))
        if self._recent is None:
            self._recent = np.zeros((channels, self._lags, columns))
        missing = self._lags - self._since
        if missing > 0:
            self._first.append(block[:, :missing])
        run = np.concatenate([self._recent, block], axis=1)
        now = block.transpose(0, 2, 1)
        for lag in range(self._lags + 1):
            before = run[:, self._lags - lag : self._lags - lag + rows]
            self._products[lag] += np.matmul(now, before)
        self._rows += rows
        self._since += rows
        self._recent = run[:, rows:]

    def pause(self) -> None:
        """What comes next does not follow what came last."""
        self._edges += self._open()
        self._begin()

    def finish(self) -> LaggedProducts:
        """The sums."""
        assert self._products is not None
        first, last = zip(*self._edges, *self._open(), strict=True)
        return LaggedProducts(self._rows, self._products, np.stack(first), np.stack(last))

    def _open(self) -> list[tuple[Array, Array]]:
        """First and last rows of the sequence that is not closed, if it has any."""
        if self._recent is None:
            return []
        channels, _, columns = self._recent.shape
        first = np.concatenate([*self._first, np.zeros((channels, 0, columns))], axis=1)
        room = np.zeros((channels, self._lags - first.shape[1], columns))
        return [(np.concatenate([first, room], axis=1), self._recent)]
