"""How the power of a signal is spread over frequency."""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array

SEGMENT = 2048
"""Most samples of a segment; halves overlap, Hann's window, means taken off."""


def spectrum(signal: Array, rate: float) -> tuple[Array, Array]:
    """Amplitude density of a signal over frequency [Hz], [unit/sqrt(Hz)]: Welch's means.

    The square's integral over frequency is the signal's variance.

    Args:
        signal: (M,).
        rate: Samples a second [Hz].
    """
    from scipy.signal import welch  # half a second to import, and only reports need it

    size = min(SEGMENT, len(signal))
    frequency, power = welch(signal, rate, window="hann", nperseg=size, detrend="constant")
    return np.asarray(frequency[1:]), np.asarray(np.sqrt(power[1:]))


def rms_within(frequency: Array, density: Array, low: float, high: float) -> float:
    """Rms of the part of a signal between two frequencies [unit].

    Args:
        frequency: Evenly spaced [Hz].
        density: Amplitude density there [unit/sqrt(Hz)].
        low: Included [Hz].
        high: Not included [Hz].
    """
    part = (frequency >= low) & (frequency < high)
    step = float(frequency[1] - frequency[0]) if len(frequency) > 1 else 0.0
    return float(np.sqrt(np.sum(density[part] ** 2) * step))
