"""Samples of a source at other instants: low-passed, splined, and brought into common rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.importing.source_clock import BRIDGED, BRIDGED_SAMPLES

PASSING, ATTENUATION = 0.7, 80.0
"""Part of half the grid's rate that passes; how much the rest is taken down [dB]."""

FASTER = 1.01
"""Times the grid's rate from which a source is faster."""

SAME = 3e-7
"""Instants so near are the same, and samples stay what they are, to the bit: seconds since 1970
are no finer as doubles [s]."""

FEWEST = 4
"""Samples of a signal."""

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
    taps, _ = _kaiser(source_rate, rate)
    return (taps // 2) / source_rate


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
    return _spline(time, values, even)(np.clip(grid, time[0], time[-1]))


def _spline(time: Array, values: Array, even: bool) -> Callable[[Array], Array]:
    from scipy.interpolate import make_interp_spline

    found: Callable[[Array], Array] = make_interp_spline(
        time, values, k=min(5 if even else 3, len(time) - 1)
    )
    return found


def _kaiser(source_rate: float, rate: float) -> tuple[int, float]:
    """Length of the low-pass, odd, and the shape of its window."""
    from scipy.signal import kaiserord

    taps, beta = kaiserord(ATTENUATION, (1 - PASSING) * rate / source_rate)
    return int(taps) | 1, float(beta)


def _filtered(
    values: Array, time: Array, source_rate: float, rate: float
) -> tuple[Array, Array]:
    """A signal without what a slower grid cannot hold, where the filter has all it needs."""
    from scipy.signal import firwin, oaconvolve

    taps, beta = _kaiser(source_rate, rate)
    cutoff = (1 + PASSING) / 2 * rate / source_rate
    weights = firwin(taps, cutoff, window=("kaiser", beta))
    middle = values.mean(axis=0)
    found = oaconvolve(values - middle, weights[:, None], mode="valid", axes=0) + middle
    return found, time[taps // 2 : taps // 2 + len(found)]


def on_common_rows(time: Array, values: Array) -> tuple[NDArray[np.intp], Array]:
    """Columns of several devices, which are never in one row, splined onto the rows of one.

    Args:
        time: (M,) [s].
        values: (M, k); nan where the row is another device's.

    Returns:
        The rows of the column that has most, in the time of all; values there, (M, k).
    """
    own = [np.flatnonzero(np.isfinite(each) & np.isfinite(time)) for each in values.T]
    own = [rows[np.append(True, np.diff(time[rows]) > 0)] for rows in own if len(rows)]
    low, high = max(time[rows[0]] for rows in own), min(time[rows[-1]] for rows in own)
    most = max(own, key=len)
    common = most[(time[most] >= low) & (time[most] <= high)]
    found = np.full(values.shape, np.nan)
    for k, rows in enumerate(own):
        apart = np.diff(time[rows])
        if len(rows) >= FEWEST and apart.max() <= max(
            BRIDGED, BRIDGED_SAMPLES * np.median(apart)
        ):
            found[common, k] = _spline(time[rows], values[rows, k], even=False)(
                time[common]
            )
    return common[np.isfinite(found[common]).all(axis=1)], found
