"""Covariance of a fit under noise that lasts a while: sums of scores over neighbouring rows."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array

WINDOW = 0.5
"""Longest time over which residuals are taken to be correlated [s]."""


def bin_size(rate: float) -> int:
    """Rows whose scores are added up at once: a power of two up to 64.

    Args:
        rate: Rows a second [Hz].
    """
    size = 1
    # least number of bins in a window
    while size < 64 and 2 * size * 6 <= WINDOW * rate:
        size *= 2
    return size


def score_squares(scores: Array, rate: float) -> Array:
    """Sum over all pairs of scores of one window, with Bartlett's weights, (p, p).

    Args:
        scores: Of consecutive bins, (bins, p).
        rate: Rows a second [Hz].
    """
    lags = max(int(WINDOW * rate / bin_size(rate)), 1)
    sums = np.cumsum(np.pad(scores, ((lags + 1, lags), (0, 0))), axis=0)
    windows = sums[lags + 1 :] - sums[: -lags - 1]
    return np.asarray(windows.T @ windows / (lags + 1))


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
