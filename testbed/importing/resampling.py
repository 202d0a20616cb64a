"""Resampling of signals by low-pass filters and splines, onto a grid or common rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.importing.source_clock import DEFAULT_MAX_GAP, DEFAULT_MAX_GAP_SAMPLES

PASSBAND_SHARE, STOPBAND_ATTENUATION = 0.7, 80.0
"""Passband as a share of the grid's Nyquist frequency; attenuation in the stopband [dB]."""

MIN_RATE_RATIO = 1.01
"""Ratio of source rate to grid rate from which on a source is low-passed."""

TIME_TOLERANCE = 3e-7
"""Largest difference of instants that count as equal [s]: the resolution of doubles for seconds
since 1970. Samples at such instants are not changed."""

MIN_SIGNAL_SAMPLES = 4
"""Smallest number of samples of a signal."""

MAX_STEP_SPREAD = 0.01
"""Relative spread of sampling intervals above which splines are cubic: splines of fifth degree
oscillate between uneven samples."""


def filter_half_length(source_rate: float, rate: float) -> float:
    """Half length of the anti-alias filter that precedes resampling [s].

    The filtered signal is shorter than the source by this time at both ends. The half length is 0
    for source rates up to 1.01 times the rate of the grid, which need no filter.

    Args:
        source_rate: Sampling rate of the source [Hz].
        rate: Rate of the grid [Hz].
    """
    if source_rate <= MIN_RATE_RATIO * rate:
        return 0.0
    taps, _ = _kaiser_design(source_rate, rate)
    return (taps // 2) / source_rate


def resample_to_grid(
    time: Array, values: Array, source_rate: float, grid: Array
) -> Array:
    """Signal at the instants of a uniform grid, (L, k).

    A source that is faster than the grid is first low-pass filtered by a linear-phase FIR filter,
    with a passband up to 0.7 times the Nyquist frequency of the grid; a spline then interpolates
    the signal. Samples that coincide with all grid times are returned unchanged.

    Args:
        time: Sample times, increasing, (M,) [s].
        values: Signal, (M, k).
        source_rate: Sampling rate [Hz].
        grid: Grid times, at least `filter_half_length` inside the ends of `time`, (L,) [s].
    """
    rate = (len(grid) - 1) / (grid[-1] - grid[0])
    first = int(np.searchsorted(time, grid[0] - TIME_TOLERANCE))
    coinciding = time[first : first + len(grid)]
    if (
        len(coinciding) == len(grid)
        and np.abs(coinciding - grid).max() < TIME_TOLERANCE
    ):
        return values[first : first + len(grid)]
    steps = np.diff(time)
    is_even = float(np.std(steps)) <= MAX_STEP_SPREAD * float(np.median(steps))
    if source_rate > MIN_RATE_RATIO * rate:
        count = int(np.floor((time[-1] - time[0]) * source_rate)) + 1
        if not is_even or count < len(time):
            uniform_time = np.minimum(
                time[0] + np.arange(count) / source_rate, time[-1]
            )
            values, time = (
                _interpolating_spline(time, values, is_even)(uniform_time),
                uniform_time,
            )
        values, time = _low_passed(values, time, source_rate, rate)
        is_even = True
    return _interpolating_spline(time, values, is_even)(
        np.clip(grid, time[0], time[-1])
    )


def _interpolating_spline(
    time: Array, values: Array, is_even: bool
) -> Callable[[Array], Array]:
    """Interpolating spline of a signal, of degree 5 for evenly spaced samples and 3 otherwise."""
    from scipy.interpolate import make_interp_spline

    spline: Callable[[Array], Array] = make_interp_spline(
        time, values, k=min(5 if is_even else 3, len(time) - 1)
    )
    return spline


def _kaiser_design(source_rate: float, rate: float) -> tuple[int, float]:
    """Odd number of taps of the low-pass filter, and shape parameter of the Kaiser window."""
    from scipy.signal import kaiserord

    taps, beta = kaiserord(
        STOPBAND_ATTENUATION, (1 - PASSBAND_SHARE) * rate / source_rate
    )
    return int(taps) | 1, float(beta)


def _low_passed(
    values: Array, time: Array, source_rate: float, rate: float
) -> tuple[Array, Array]:
    """Low-pass filtered signal and its times, without the ends that the filter does not cover."""
    from scipy.signal import firwin, oaconvolve

    taps, beta = _kaiser_design(source_rate, rate)
    cutoff = (1 + PASSBAND_SHARE) / 2 * rate / source_rate
    weights = firwin(taps, cutoff, window=("kaiser", beta))
    mean = values.mean(axis=0)
    filtered = oaconvolve(values - mean, weights[:, None], mode="valid", axes=0) + mean
    return filtered, time[taps // 2 : taps // 2 + len(filtered)]


def spline_to_common_rows(time: Array, values: Array) -> tuple[NDArray[np.intp], Array]:
    """Interpolate columns of several devices, which share no row, to common rows.

    Args:
        time: Time of each row, (M,) [s].
        values: Values, (M, k); nan where a row belongs to another device.

    Returns:
        Indices of the common rows, and interpolated values (M, k), nan in other rows. The common
        rows are those of the column with the most values, within the interval that all columns
        cover. There are no common rows if a column has fewer than four values, or a gap above 0.1 s
        and three sampling intervals.
    """
    rows_of_columns = [
        np.flatnonzero(np.isfinite(each) & np.isfinite(time)) for each in values.T
    ]
    rows_of_columns = [
        rows[np.append(True, np.diff(time[rows]) > 0)]
        for rows in rows_of_columns
        if len(rows)
    ]
    low, high = (
        max(time[rows[0]] for rows in rows_of_columns),
        min(time[rows[-1]] for rows in rows_of_columns),
    )
    longest = max(rows_of_columns, key=len)
    common = longest[(time[longest] >= low) & (time[longest] <= high)]
    splined = np.full(values.shape, np.nan)
    for k, rows in enumerate(rows_of_columns):
        steps = np.diff(time[rows])
        if len(rows) >= MIN_SIGNAL_SAMPLES and steps.max() <= max(
            DEFAULT_MAX_GAP, DEFAULT_MAX_GAP_SAMPLES * np.median(steps)
        ):
            splined[common, k] = _interpolating_spline(
                time[rows], values[rows, k], is_even=False
            )(time[common])
    return common[np.isfinite(splined[common]).all(axis=1)], splined
