"""The period of a motion, as its encoders show it."""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array

ALIKE = 1e-3
"""Mean square of the difference to one period before, relative to that of far instants."""

UNLIKE = 0.3
"""The same where a motion has left where it was: a period is more than standing still."""

AT_REST = 1e-2
"""Part of the largest joint's spread below which a joint shows little but noise."""

FEWEST = 4
"""Samples in which nothing repeats."""


def period_of(position: Array) -> int | None:
    """The shortest time after which a motion repeats, in samples; None if it does not.

    Only motions that are seen for one and a half periods at least can show one.

    Args:
        position: Encoders at evenly spaced times, (m, n) [rad or m].
    """
    if len(position) < FEWEST:
        return None
    spread = position.std(axis=0)
    moving = position[:, spread > AT_REST * spread.max(initial=0.0)]
    if not moving.shape[1]:
        return None
    unit = (moving - moving.mean(axis=0)) / moving.std(axis=0)
    apart = _differences(unit)
    left = np.flatnonzero(apart > UNLIKE)
    if not len(left):
        return None
    near = np.flatnonzero(apart[left[0] :] < ALIKE) + left[0]
    if not len(near):
        return None
    first = int(near[0])
    away = np.flatnonzero(apart[first:] >= ALIKE)
    last = first + int(away[0]) if len(away) else len(apart)
    return first + int(np.argmin(apart[first:last]))


def _differences(unit: Array) -> Array:
    """Mean square of x_t - x_(t - lag) over 2, for lags up to two thirds of the samples."""
    count, channels = unit.shape
    lags = np.arange(2 * count // 3 + 1)
    size = 1 << int(2 * count - 1).bit_length()
    spectrum = np.fft.rfft(unit, size, axis=0)
    products = np.fft.irfft((np.abs(spectrum) ** 2).sum(axis=1), size)[lags]
    ends = np.concatenate([[0.0], np.cumsum((unit**2).sum(axis=1))])
    later, earlier = ends[-1] - ends[lags], ends[count - lags]
    return np.asarray((later + earlier - 2 * products) / (2 * channels * (count - lags)))
