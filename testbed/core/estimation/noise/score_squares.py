"""Covariance of a fit under noise that lasts a while: sums of scores over neighbouring rows."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array

WINDOW = 0.5
"""Longest time over which residuals are taken to be correlated [s]."""

BINS = 6
"""Least number of bins in a window."""


def bin_size(rate: float) -> int:
    """Rows whose scores are added up at once: a power of two up to 64.

    Args:
        rate: Rows a second [Hz].
    """
    size = 1
    while size < 64 and 2 * size * BINS <= WINDOW * rate:
        size *= 2
    return size


class ScoreSquares:
    """Sum over all pairs of scores of one window, with Bartlett's weights, as they come."""

    def __init__(self, columns: int, rate: float) -> None:
        """Nothing yet.

        Args:
            columns: Number p of columns.
            rate: Rows a second [Hz].
        """
        self.lags = max(int(WINDOW * rate / bin_size(rate)), 1)
        self.total = np.zeros(columns)
        self._recent = np.zeros((self.lags, columns))
        self._sum = np.zeros((columns, columns))

    def add(self, scores: Array) -> None:
        """Go on with scores of consecutive bins, (bins, p)."""
        self.total += scores.sum(axis=0)
        self._slide(scores)

    def finish(self) -> Array:
        """The weighted sum, (p, p)."""
        self._slide(np.zeros_like(self._recent))
        return self._sum / (self.lags + 1)

    def _slide(self, scores: Array) -> None:
        run = np.vstack([self._recent, scores])
        sums = np.cumsum(np.vstack([np.zeros(run.shape[1]), run]), axis=0)
        windows = sums[self.lags + 1 :] - sums[: -self.lags - 1]
        self._sum += windows.T @ windows
        self._recent = run[len(run) - self.lags :]


def sandwich(inverse: Array, squares: Array) -> Array:
    """Covariance of the unknowns, (p, p).

    Args:
        inverse: Of X' W X, (p, p).
        squares: Of the scores, (p, p).
    """
    return inverse @ squares @ inverse


def hidden(weights: Array, step: int, rate: float) -> float:
    """Factor on variances for what Bartlett's weights take from filtered white noise.

    Args:
        weights: Of the filter on rows, (2 L + 1,).
        step: Samples from row to row.
        rate: Rows a second [Hz].
    """
    together = np.correlate(weights, weights, "full")[len(weights) - 1 :: step]
    lags = np.arange(len(together))
    size = bin_size(rate)
    longest = (max(int(WINDOW * rate / size), 1) + 1) * size
    share = np.maximum(1 - lags / longest, 0.0)
    both = np.where(lags == 0, 1.0, 2.0) * together
    return float(both.sum() / (share * both).sum())
