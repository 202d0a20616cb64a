"""Filters without phase and with an end: convolution with symmetric kernels.

A row that is filtered depends on the samples within reach of it and on no other, so that a
recording can be cut anywhere without a trace.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array

POSITION_ATTENUATION = 120.0
"""Of the filter on positions [dB]: what it takes from the motion would bias the estimate."""

ROW_ATTENUATION = 60.0
"""Of the filter on rows [dB]: both sides of the equations pass it, so it need not be flat."""

TRANSITION = 1.5
"""Width of the band between passing and stopping, in cutoffs; the cutoff is in its middle."""

REVERSAL_WEIGHT = 0.03
"""Part of the row filter's absolute weight that may lie on samples at a reversal."""

_FIRST = (4 / 5, -1 / 5, 4 / 105, -1 / 280)  # central differences of order eight
_SECOND = (8 / 5, -1 / 5, 8 / 315, -1 / 560)

STENCIL = len(_FIRST)
"""Samples that a derivative reaches to either side."""


def low_pass_reach(rate: float, cutoff: float | None, attenuation: float) -> float:
    """Samples L to either side that a low-pass needs; infinity where there is no such number.

    Args:
        rate: Samples a second [Hz].
        cutoff: Where its gain is one half [Hz]; None for no filter.
        attenuation: As of `low_pass` [dB].
    """
    if cutoff is None:
        return 0.0
    width = 2 * np.pi * TRANSITION * cutoff / rate  # Kaiser's rules
    return np.inf if width == 0 else float(np.ceil((attenuation - 7.95) / (2.285 * width) / 2))


def low_pass(rate: float, cutoff: float, attenuation: float) -> Array:
    """Weights of a symmetric low-pass, (2 L + 1,), of sum one; a windowed sinc.

    Args:
        rate: Samples a second [Hz].
        cutoff: Where its gain is one half [Hz].
        attenuation: Beyond cutoff (1 + TRANSITION / 2), and how flat it is below
            cutoff (1 - TRANSITION / 2) [dB].
    """
    reach = int(low_pass_reach(rate, cutoff, attenuation))
    window = np.kaiser(2 * reach + 1, 0.1102 * (attenuation - 8.7))
    weights = window * np.sinc(2 * cutoff / rate * np.arange(-reach, reach + 1))
    return np.asarray(weights / weights.sum())


def motion_taps(rate: float, cutoff: float | None) -> Array:
    """Kernels that make position, velocity and acceleration of encoder positions.

    Args:
        rate: Samples a second [Hz].
        cutoff: Of the low-pass on positions [Hz]; None for none.

    Returns:
        (3, 2 L + 1), in the order of time: x[k] = sum over l of taps[l] q[k - L + l].
    """
    first, second = np.array(_FIRST) * rate, np.array(_SECOND) * rate**2
    position = np.zeros(2 * STENCIL + 1)
    position[STENCIL] = 1.0
    stencils = (
        position,
        np.concatenate([-first[::-1], [0.0], first]),
        np.concatenate([second[::-1], [-2 * second.sum()], second]),
    )
    weights = np.ones(1) if cutoff is None else low_pass(rate, cutoff, POSITION_ATTENUATION)
    return np.stack([np.convolve(weights, stencil) for stencil in stencils])


def slope_weights(weights: Array, places: NDArray[np.int64], rate: float) -> Array:
    """Weights that make a filtered signal's derivative of the signal at some samples, (k,) [1/s].

    By parts: the signal's derivative times the filter is the signal times the filter's, and a
    part at either end, where the filter stops.

    Args:
        weights: Of the filter, symmetric, (2 L + 1,).
        places: The samples, evenly spaced around the filter's middle, (k,).
        rate: Samples a second [Hz].
    """
    if len(places) == 1:
        return np.zeros(1)
    at = places + len(weights) // 2
    found = -float(places[1] - places[0]) * _slopes(weights)[at]
    found[[0, -1]] /= 2
    found[[0, -1]] += np.array([-1.0, 1.0]) * weights[at[-1]]
    return np.asarray(found * rate / (found @ places))


def _slopes(values: Array) -> Array:
    """Derivatives at evenly spaced values, (k,), of the polynomial through the nearest ones."""
    size = min(2 * STENCIL + 1, len(values))
    powers, nodes = np.arange(size), np.arange(size) - size // 2
    slope = powers * nodes[:, None] ** np.maximum(powers - 1.0, 0.0)
    differences = slope @ np.linalg.inv(np.vander(nodes, increasing=True))  # at each of the nodes
    at = np.arange(len(values))
    first = np.clip(at - size // 2, 0, len(values) - size)
    near = np.lib.stride_tricks.sliding_window_view(values, size)[first]
    return np.asarray((differences[at - first] * near).sum(axis=1))


def row_weights(rate: float, cutoff: float | None) -> Array:
    """Weights of the parallel filter on rows, (2 L + 1,); a single one for none.

    Args:
        rate: Samples a second [Hz].
        cutoff: Where its gain is one half [Hz]; None for none.
    """
    return np.ones(1) if cutoff is None else low_pass(rate, cutoff, ROW_ATTENUATION)


def reversal_samples(weights: Array, reach: float | None, rate: float) -> int:
    """Samples to either side of a row at which its joint has to move.

    Dry friction jumps at a reversal, and the filter on rows carries the jump to all rows that
    it reaches.

    Args:
        weights: Of the filter on rows, (2 L + 1,).
        reach: As a time [s], at most the filter's own; None for what leaves REVERSAL_WEIGHT of
            the filter's absolute weight beyond.
        rate: Samples a second [Hz].
    """
    half = len(weights) // 2
    if reach is not None:
        return min(half, round(reach * rate))
    size = np.abs(weights)
    beyond = 2 * np.cumsum(size)[:half] / size.sum()  # of reaches half - 1, ..., 0
    return half - int(np.count_nonzero(beyond < REVERSAL_WEIGHT))
