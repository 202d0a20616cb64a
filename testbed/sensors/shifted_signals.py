"""Interpolation of signals at shifted or arbitrary times."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array

_INTERPOLATION_POINTS = 8
"""Number of samples in Lagrange interpolation: exact for polynomials of lower degree."""


def shifted_signal(signal: Array, samples: float) -> Array:
    """Signal advanced by a number of samples, by Lagrange interpolation of eight samples.

    Args:
        signal: Signal, (M, k); its first and last values are held beyond its ends.
        samples: Number of samples, positive or negative, not necessarily an integer. Sample i of
            the result is the signal at sample i + samples.
    """
    whole = int(np.floor(samples))
    nodes = np.arange(_INTERPOLATION_POINTS) - (_INTERPOLATION_POINTS // 2 - 1)
    gaps = (samples - whole) - nodes
    weights = np.array(
        [
            np.prod(np.delete(gaps, k)) / np.prod(np.delete(node - nodes, k))
            for k, node in enumerate(nodes)
        ]
    )
    indices = np.arange(len(signal))
    result = np.zeros_like(signal)
    for node, weight in zip(nodes, weights, strict=True):
        result += weight * signal[np.clip(indices + whole + node, 0, len(signal) - 1)]
    return result


def edge_samples(delay: float, rate: float) -> int:
    """Number of samples at each end that lack neighbours for the correction of a delay.

    Args:
        delay: Delay [s].
        rate: Sampling rate [Hz].
    """
    return int(np.ceil(abs(delay) * rate)) + _INTERPOLATION_POINTS // 2 if delay else 0


def resampled_signal(signal: Array, time: Array, instants: Array) -> Array:
    """Signal at other times, by a quintic spline; values are held beyond the ends.

    Args:
        signal: Signal, (M, k).
        time: Times of the samples, (M,) [s].
        instants: Times of the result, (L,) [s].
    """
    from scipy.interpolate import make_interp_spline

    spline = make_interp_spline(time, signal, k=min(5, len(time) - 1))
    result: Array = spline(np.clip(instants, time[0], time[-1]))
    return result
