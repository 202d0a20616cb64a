"""How the power of a signal is spread over frequency."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

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
    size = min(SEGMENT, len(signal))
    parts = sliding_window_view(signal, size)[:: size - size // 2]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / size)
    lines = np.fft.rfft(window * (parts - parts.mean(axis=1, keepdims=True)))
    power = 2 * (np.abs(lines) ** 2).mean(axis=0) / (rate * (window @ window))
    if size % 2 == 0:
        power[-1] /= 2  # half the sampling rate stands for itself alone
    return np.asarray(np.fft.rfftfreq(size, 1 / rate)[1:]), np.asarray(np.sqrt(power[1:]))


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
