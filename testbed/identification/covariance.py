"""An honest covariance: filtered residuals are correlated, and the formula must know.

The sandwich of heteroskedasticity- and autocorrelation-consistent (HAC) estimation: sums
of the scores' autocovariances with Bartlett's weights.
"""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.identification.prepare import Equations
from testbed.identification.solve import Solution

WINDOW = 0.5
"""Longest time over which residuals are taken to be correlated [s]."""

SMALL_SAMPLE = 1.1
"""Factor on sigma for what Bartlett's weights and the fit itself hide (tests: coverage)."""


def hac_covariance(equations: Equations, solution: Solution) -> Array:
    """Covariance of the unknowns, (p, p).

    Args:
        equations: Rows in the order of time, at a constant rate.
        solution: Their solution.
    """
    scores = np.zeros((len(solution.residuals[0]), len(solution.values)))
    parts = zip(equations.channels, solution.residuals, solution.noise, strict=True)
    for channel, residual, noise in parts:
        scores += channel.columns * (channel.used * residual / noise**2)[:, None]
    lags = min(int(WINDOW * equations.rate), len(scores) - 1)
    meat = scores.T @ scores
    for lag in range(1, lags + 1):
        weight = 1 - lag / (lags + 1)
        overlap = scores[lag:].T @ scores[:-lag]
        meat += weight * (overlap + overlap.T)
    covariance: Array = SMALL_SAMPLE**2 * solution.normal @ meat @ solution.normal
    return covariance
