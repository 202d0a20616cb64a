"""From a source's own samples to a uniform grid: low-pass before fewer samples, then splines.

Below 0.7 of half the grid's rate a signal stays what it is (to 1e-4); what could fold into it
is taken away. No phase. Where the filter reaches beyond a source's ends there are no samples.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from testbed.arrays import Array

PASSING, ATTENUATION = 0.7, 80.0
"""Part of half the grid's rate that passes; how much the rest is taken down [dB]."""

FASTER = 1.01
"""Times the grid's rate from which a source is faster."""

SAME = 3e-7
"""Instants so near are the same, and samples stay what they are, to the bit: seconds since 1970
are no finer as doubles [s]."""

UNEVEN = 0.01
"""Spread of sampling times, relative, from which splines are of lower degree: those of fifth
degree swing between uneven samples."""


def low_pass_reach(source_rate: float, rate: float) -> float:
    """How much of a source's ends the filter takes [s]; 0 without one.

    Args:
        source_rate: Samples a second of the source [Hz].
        rate: Of the grid [Hz].
    """
    if source_rate <= FASTER * rate:
        return 0.0
    return (_taps(source_rate, rate) // 2) / source_rate


def onto_grid(time: Array, values: Array, source_rate: float, grid: Array) -> Array:
    """A signal at the instants of a uniform grid, (L, k).

    Args:
        time: Of the samples, increasing, (M,) [s].
        values: (M, k).
        source_rate: Samples a second [Hz].
        grid: Within `time`, by `low_pass_reach` from its ends, (L,) [s].
    """
    rate = (len(grid) - 1) / (grid[-1] - grid[0])
    first = int(np.searchsorted(time, grid[0] - SAME))
    same = time[first : first + len(grid)]
    if len(same) == len(grid) and np.abs(same - grid).max() < SAME:
        return values[first : first + len(grid)]
    steps = np.diff(time)
    even = float(np.std(steps)) <= UNEVEN * float(np.median(steps))
    if source_rate > FASTER * rate:
        count = int(np.floor((time[-1] - time[0]) * source_rate)) + 1
        if not even or count < len(time):
            steady = np.minimum(time[0] + np.arange(count) / source_rate, time[-1])
            values, time = _spline(time, values, even)(steady), steady
        values, time = _filtered(values, time, source_rate, rate)
        even = True
    found: Array = _spline(time, values, even)(np.clip(grid, time[0], time[-1]))
    return found


def _spline(time: Array, values: Array, even: bool) -> Callable[[Array], Array]:
    from scipy.interpolate import make_interp_spline

    found: Callable[[Array], Array] = make_interp_spline(
        time, values, k=min(5 if even else 3, len(time) - 1)
    )
    return found


def _taps(source_rate: float, rate: float) -> int:
    """Length of the low-pass, odd, by Kaiser's rule."""
    width = np.pi * (1 - PASSING) * rate / source_rate
    return 2 * int(np.ceil((ATTENUATION - 7.95) / (2.285 * width) / 2)) + 1


def _filtered(values: Array, time: Array, source_rate: float, rate: float) -> tuple[Array, Array]:
    """A signal without what a slower grid cannot hold, where the filter has all it needs."""
    from scipy.signal import firwin, oaconvolve

    taps = _taps(source_rate, rate)
    cutoff = (1 + PASSING) / 2 * rate / source_rate
    weights = firwin(taps, cutoff, window=("kaiser", 0.1102 * (ATTENUATION - 8.7)))
    middle = values.mean(axis=0)
    found = oaconvolve(values - middle, weights[:, None], mode="valid", axes=0) + middle
    return found, time[taps // 2 : taps // 2 + len(found)]
