"""Weights of the channels, from their residuals or from what is known of their noise."""

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
