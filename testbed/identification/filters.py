"""Zero-phase low-pass filter and numerical derivatives of uniformly sampled signals."""

from __future__ import annotations

import numpy as np
from scipy import signal

from testbed.arrays import Array

ORDER = 4
"""Of the Butterworth filter, run forwards and backwards."""

STENCIL = 2
"""Samples at each end where the derivatives are one-sided and should be cut off."""


def low_pass(values: Array, rate: float, cutoff: float) -> Array:
    """Zero-phase Butterworth low-pass along the first axis.

    Args:
        values: (M, ...).
        rate: Samples a second [Hz].
        cutoff: Where one pass is down by 3 dB [Hz].
    """
    sections = signal.butter(ORDER, cutoff, fs=rate, output="sos")
    filtered: Array = signal.sosfiltfilt(sections, values, axis=0)
    return filtered


def settling(cutoff: float) -> float:
    """Time at each end of a filtered signal that the ends distort [s]."""
    return 2.5 / cutoff


def derivatives(q: Array, rate: float) -> tuple[Array, Array]:
    """First and second derivative by fourth-order central differences.

    Args:
        q: (M, n).
        rate: Samples a second [Hz].

    Returns:
        (M, n) each; the first and last STENCIL rows repeat their neighbours.
    """
    a, b, c, d, e = (q[k : len(q) - 4 + k] for k in range(5))
    first = rate * (8 * (d - b) - (e - a)) / 12
    second = rate**2 * (16 * (b + d) - (a + e) - 30 * c) / 12
    ends = ((STENCIL, STENCIL), (0, 0))
    return np.pad(first, ends, mode="edge"), np.pad(second, ends, mode="edge")
