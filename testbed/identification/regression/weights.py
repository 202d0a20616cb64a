"""Weights of the channels, and a calibrated covariance where residuals are correlated."""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.identification.regression.normal_equations import NormalEquations

REWEIGHTINGS = 4
"""Times that the channels' noise is estimated anew from the residuals."""

PRECISION = 1e-7
"""Least noise of a channel relative to its measurement: what sums of products can resolve."""


def noise_weights(
    equations: NormalEquations, covariance: Array | None, full: bool = False
) -> Array:
    """W, (C, C): the inverse of the noise's covariance.

    Args:
        equations: Of all rows.
        covariance: Of the noise, if it is known.
        full: Whether channels are taken as correlated.
    """
    if covariance is not None:
        return np.asarray(np.linalg.inv(covariance))
    rms = np.sqrt(equations.squares) / np.sqrt(np.maximum(equations.used, 1.0))
    floor = np.maximum(PRECISION * rms, PRECISION**2 * (rms.max() or 1.0))
    weights = np.eye(len(equations.channels))
    for _ in range(REWEIGHTINGS):
        values = _rough(equations, weights)
        weights = _from_residuals(equations, equations.residual(values), floor, full)
    return weights


def _from_residuals(equations: NormalEquations, squares: Array, floor: Array, full: bool) -> Array:
    share = len(equations.unknowns) / len(equations.channels)
    free = np.maximum(equations.used - share, 1.0)
    spread = squares / np.sqrt(np.outer(free, free))
    variance = np.maximum(np.diagonal(spread), floor**2)
    if not full:
        return np.diag(1 / variance)
    correlation = spread / np.sqrt(np.outer(variance, variance))
    np.fill_diagonal(correlation, 1 + PRECISION)
    return np.linalg.inv(correlation) / np.sqrt(np.outer(variance, variance))


def _rough(equations: NormalEquations, weights: Array) -> Array:
    """A solution good enough for weights, whatever the condition."""
    matrix, vector = equations.matrix(weights), equations.vector(weights)
    scale = np.sqrt(np.diagonal(matrix))
    scale[scale == 0] = 1.0
    unit = matrix / np.outer(scale, scale)
    values: Array = np.linalg.lstsq(unit, vector / scale, rcond=1e-13)[0] / scale
    return values


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
    covariance: Array = inverse @ squares @ inverse
    return covariance


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
