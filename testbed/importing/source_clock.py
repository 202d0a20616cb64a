"""Clock of a source: sample times from time stamps, repeated samples and gaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import RecordingError, count_with_noun
from testbed.importing.foreign_table import TIME_UNITS
from testbed.importing.mapping import SourceTable

DEFAULT_MAX_GAP, DEFAULT_MAX_GAP_SAMPLES = 0.1, 3.0
"""Longest gap that is interpolated by default [s], and in samples if that is longer."""

MIN_GAP_INTERVALS = 1.5
"""Number of sampling intervals from which on a step is a gap."""

MAX_STAMP_DEVIATION = 0.5
"""Largest deviation of a steady device's smoothed stamps from a line, in sampling intervals."""

SMOOTHING_WIDTH = 101
"""Number of time stamps over which jitter is averaged."""

MINUTE = TIME_UNITS["min"]
"""Whole number of all units of time [s]."""

MAX_SAMPLING_TIME, MIN_SAMPLING_TIME = 1e9, 1e-9
"""Largest and smallest plausible sampling interval [s]."""


def longest_interpolated_gap(table: SourceTable, typical: float) -> float:
    """Longest gap between samples that is interpolated by a spline [s].

    It is `max_gap` of the mapping if stated; otherwise it is the larger of 0.1 s and three sampling
    intervals.

    Args:
        table: Table of the source in the mapping.
        typical: Sampling interval of the source [s].
    """
    return table.max_gap or max(DEFAULT_MAX_GAP, DEFAULT_MAX_GAP_SAMPLES * typical)


@dataclass(frozen=True)
class ClockReport:
    """Report on the time stamps of a source.

    Attributes:
        samples: Number of samples used.
        rate: Sampling rate, the reciprocal of the median interval [Hz].
        jitter: Standard deviation of the intervals without gaps, relative to the median interval.
        gaps: Number of intervals longer than 1.5 sampling intervals.
        longest_gap: Longest interval [s].
        repeated: Number of samples omitted because they repeat time stamp and values of the sample
            before.
        lead: Time from the first sample of the source to time zero of the recording [s].
        cut: True if an incomplete last sample was omitted.
        even: True if the stamps agree with a constant rate.
        missing: Number of samples that are missing in the gaps or have no numeric value.
    """

    samples: int
    rate: float
    jitter: float
    gaps: int
    longest_gap: float
    repeated: int
    lead: float = 0.0
    cut: bool = False
    even: bool = True
    missing: int = 0


@dataclass(frozen=True, eq=False)
class SourceTimes:
    """Sample times of a source according to its own clock.

    Seconds since 1970 with nanoseconds have more digits than a floating-point number can hold, so a
    time is stored as the sum of two numbers.

    Attributes:
        start: Time of the first sample, rounded towards zero to whole minutes [s].
        time_after_start: Times after `start`, (M,) [s].
    """

    start: float
    time_after_start: Array

    @staticmethod
    def from_stamps(stamps: Array | NDArray[np.int64], unit: str) -> SourceTimes:
        """Sample times from time stamps in a given unit.

        Args:
            stamps: Time stamps, (M,).
            unit: Unit of the stamps, a key of `TIME_UNITS`.
        """
        if unit == "day":
            return SourceTimes.from_stamps(
                np.asarray(stamps * TIME_UNITS[unit], dtype=np.float64), "s"
            )
        units_per_minute = round(MINUTE / TIME_UNITS[unit])
        first = stamps[np.isfinite(stamps)][:1]
        # rounded towards zero: the product stays within 64 bits
        minutes = int(first[0] / units_per_minute) if len(first) else 0
        since = np.asarray(stamps - minutes * units_per_minute, dtype=np.float64)
        return SourceTimes(MINUTE * minutes, since * TIME_UNITS[unit])


def times_from_common_origin(
    times: Mapping[str, SourceTimes], offsets: Mapping[str, float]
) -> dict[str, Array]:
    """Times of several sources from a common origin, (M,) each [s].

    The origin is the earliest first sample, rounded to whole minutes, and is not negative.

    Args:
        times: Times according to the sources' own clocks, keyed by source.
        offsets: Time added to each source's times [s], keyed by source.
    """
    starts = (
        each.start + MINUTE * (offsets[name] // MINUTE) for name, each in times.items()
    )
    # a common origin near the data preserves digits
    start = max(0.0, min(starts))
    return {
        name: t.time_after_start + (t.start - start + offsets[name])
        for name, t in times.items()
    }


def sample_times(
    name: str, table: SourceTable, stamps: Array | NDArray[np.int64], unit: str | None
) -> SourceTimes:
    """Sample times of a source from its time stamps, before offset and skew are corrected.

    Args:
        name: Name of the source.
        table: Table of the source in the mapping.
        stamps: Time column of the source, (M,).
        unit: Unit of the times as stated in the file; None if the file states no unit.

    Raises:
        RecordingError: No stamp is finite, or the unit is missing or contradicts the file.
    """
    known = unit if unit in TIME_UNITS else None
    if table.time_unit is None and known is None:
        raise RecordingError(
            f"sources.{name}: say `time_unit`: {', '.join(TIME_UNITS)}"
        )
    if known is not None and table.time_unit not in (None, known):
        raise RecordingError(
            f"sources.{name}: the file states its times are in {known}, time_unit is "
            f"{table.time_unit}; leave time_unit out"
        )
    if not np.isfinite(stamps).any():
        raise RecordingError(f"sources.{name}: '{table.time}' holds no number")
    return SourceTimes.from_stamps(stamps, table.time_unit or known or "s")


def distinct_sample_mask(
    name: str, time: Array, values: Array, *, steady: bool = False
) -> NDArray[np.bool_]:
    """Mask of the samples that do not repeat the previous sample, (M,) of bool.

    A repetition has the time stamp and all values of the previous sample. If stamps of a steady
    device repeat with different values and never decrease, the clock is coarse, and all samples are
    kept.

    Args:
        name: Name of the source.
        time: Time stamps, (M,) [s].
        values: All columns in use, (M, k).
        steady: True if the device samples at a constant rate.

    Raises:
        RecordingError: Time does not increase at a sample that is not a repetition.
    """
    steps = np.diff(time)
    repeated = (steps == 0) & (values[1:] == values[:-1]).all(axis=1)
    invalid = ~repeated & ~(steps > 0)
    if steady and invalid.any() and not (steps < 0).any():
        return np.ones(len(time), dtype=bool)
    if invalid.any():
        k = int(np.argmax(invalid))
        raise RecordingError(
            f"sources.{name}: time does not increase after sample {k} ({time[k]:.9g} s, then "
            f"{time[k + 1]:.9g} s), {int(invalid.sum())} such; if the device samples at a constant "
            "rate, say `rate` instead of `time`"
        )
    return np.append(True, ~repeated)


def equidistant_times(name: str, time: Array, rows: NDArray[np.intp]) -> Array:
    """Equidistant times that replace stamps with jitter or coarse resolution, (M,) [s].

    `fit_time_line` fits a line to the stamps as a function of the sample number. If the stamps
    deviate from it, the line is fitted as a function of the row index.

    Args:
        name: Name of the source.
        time: Time stamps, (M,) [s].
        rows: Row indices of the samples in the file, (M,); the rows between them hold no numbers or
            belong to another device.

    Raises:
        RecordingError: The stamps agree with neither line: samples are missing.
    """
    for numbering in (np.arange(len(time)), rows):
        line, errors, is_line = fit_time_line(time, numbering)
        if is_line:
            return line
    k = int(np.argmax(np.abs(errors)))
    raise RecordingError(
        f"sources.{name}: its stamps stray from those of a steady device by "
        f"{np.abs(errors).max():.3g} s near sample {k}: samples are missing, or leave out `steady`"
    )


def fit_time_line(time: Array, number: NDArray[Any]) -> tuple[Array, Array, bool]:
    """Fit a line to time stamps, and test the stamps for a constant rate.

    If stamps repeat because the clock is coarse, the line is fitted to the stamps at which the
    clock advances; the rate is constant if the deviations span at most two intervals. Otherwise the
    rate is constant if the moving average of the deviations over 101 stamps is at most half an
    interval.

    Args:
        time: Time stamps, (M,) [s].
        number: Numbers of the samples, (M,), for example 0, 1, ....

    Returns:
        Times on the line (M,) [s], the tested deviations of the stamps from the line [s], and True
        if the stamps agree with a constant rate.
    """
    jumps = np.flatnonzero(np.diff(time) > 0) + 1
    # where a coarse clock advances, the delay is less than one step
    if len(jumps) < len(time) - 1:
        slope, intercept = _fitted_line(number[jumps], time[jumps])
        deviation = time[jumps] - intercept - slope * number[jumps]
        if slope > 0 and np.ptp(deviation) <= 2 * slope:
            return intercept + slope * number, deviation, True
    slope, intercept = _fitted_line(number, time)
    line: Array = intercept + slope * number
    width = min(SMOOTHING_WIDTH, len(time))
    deviation = np.convolve(time - line, np.ones(width) / width, mode="valid")
    return (
        line,
        deviation,
        slope > 0 and bool(np.abs(deviation).max() <= MAX_STAMP_DEVIATION * slope),
    )


def _fitted_line(number: NDArray[Any], time: Array) -> tuple[float, float]:
    """Slope and intercept of the least-squares line of times as a function of sample numbers.

    Both are zero for fewer than two samples.
    """
    if len(number) < 2:
        return 0.0, 0.0
    centred = number - number.mean()
    slope = float(centred @ (time - time.mean()) / (centred @ centred))
    return slope, float(time.mean() - slope * number.mean())


def clock_report(
    name: str, table: SourceTable, stamps: Array, time: Array, repeated: int
) -> ClockReport:
    """Report on the time stamps of a source; too long a gap is refused.

    Args:
        name: Name of the source.
        table: Table of the source in the mapping.
        stamps: Time stamps before they were replaced by equidistant times, (M,) [s].
        time: Sample times in use, (M,) [s].
        repeated: Number of repeated samples that were omitted.

    Raises:
        RecordingError: There are fewer than four samples, the median interval is outside 1e-9 s to
            1e9 s, or a gap is longer than `longest_interpolated_gap`.
    """
    if len(time) < 4:
        raise RecordingError(
            f"sources.{name}: {count_with_noun(len(time), 'sample')}, which is no recording"
        )
    steps, steps_used = np.diff(stamps), np.diff(time)
    typical = float(np.median(steps_used))
    if not MIN_SAMPLING_TIME < typical < MAX_SAMPLING_TIME:
        raise RecordingError(
            f"sources.{name}: {typical:.3g} s from sample to sample is no sampling time; "
            "check `time_unit`"
        )
    longest = float(steps_used.max())
    if longest > longest_interpolated_gap(table, typical):
        k = int(np.argmax(steps_used))
        raise RecordingError(
            f"sources.{name}: nothing was recorded for {longest:.3g} s after "
            f"{time[k] - time[0]:.6g} s; `testbed import` cuts it there, `start` and `stop` "
            f"take one part, `max_gap` = {longest:.3g} bridges it"
        )
    regular = steps[steps <= MIN_GAP_INTERVALS * typical]
    jitter = float(np.std(regular) / typical) if len(regular) else 0.0
    gaps = steps_used > MIN_GAP_INTERVALS * typical
    missing = int((np.round(steps_used[gaps] / typical) - 1).sum())
    is_line = fit_time_line(stamps, np.arange(len(stamps)))[2]
    return ClockReport(
        len(time),
        1 / typical,
        jitter,
        int(gaps.sum()),
        longest,
        repeated,
        even=is_line,
        missing=missing,
    )


MIN_PIECE_LENGTH = 1.0
"""Shortest interval between two gaps that becomes a recording [s]."""

Window = tuple[float, float]
"""First and last instant [s]."""


def windows_between_gaps(
    window: Window, clocks: Sequence[tuple[str, SourceTable, Array, NDArray[np.intp]]]
) -> tuple[list[Window], list[Diagnostic]]:
    """Intervals of a window between long gaps of the sources, and diagnostics of the gaps.

    The window is divided at gaps longer than `longest_interpolated_gap`; intervals shorter than 1 s
    are omitted. If there is no such gap or no interval remains, the whole window is returned
    without diagnostics.

    Args:
        window: Interval to be divided [s].
        clocks: For each signal: source name, the source's table in the mapping, sample times (M,)
            [s] and row indices in the file (M,).
    """
    gaps = {
        (*gap, name)
        for name, source, time, rows in clocks
        for gap in _gap_intervals(source, time, rows)
    }
    windows, diagnostics, begin = [], [], window[0]
    for last, first, name in sorted(gaps):
        if first <= window[0] or last >= window[1]:
            continue
        windows.append((begin, last))
        begin = max(begin, first)
        diagnostics.append(
            make_diagnostic("import.cut", name, first - last, begin=last - window[0])
        )
    windows.append((begin, window[1]))
    long_windows = [each for each in windows if each[1] - each[0] >= MIN_PIECE_LENGTH]
    if not diagnostics or not long_windows:
        return [window], []
    if short_count := len(windows) - len(long_windows):
        diagnostics.append(
            make_diagnostic(
                "import.short", count_with_noun(short_count, "piece"), MIN_PIECE_LENGTH
            )
        )
    return long_windows, diagnostics


def slice_within_gaps(
    source: SourceTable,
    time: Array,
    rows: NDArray[np.intp],
    part: slice,
    window: Window,
) -> slice:
    """Slice of the samples near a window, cut at long gaps outside the window.

    Args:
        source: Table of the source in the mapping.
        time: Sample times, (M,) [s].
        rows: Row indices of the samples in the file, (M,).
        part: Slice of the samples in the window and of some neighbouring samples.
        window: Interval of the recording [s].
    """
    first, stop = part.start, part.stop
    for gap_start, gap_end in _gap_intervals(source, time, rows):
        if gap_end <= window[0]:
            first = max(first, int(np.searchsorted(time, gap_end)))
        if gap_start >= window[1]:
            stop = min(stop, int(np.searchsorted(time, gap_start, side="right")))
            break
    return slice(first, stop)


def _gap_intervals(
    source: SourceTable, time: Array, rows: NDArray[np.intp]
) -> list[Window]:
    """Times of the samples before and after each gap beyond `longest_interpolated_gap` [s].

    For a steady device, the gaps follow from the row indices instead of the stamps: a late stamp is
    not a gap, but rows without numbers are.
    """
    steps = np.diff(time)
    if source.steady:
        steps = np.diff(rows) * np.ptp(time) / np.ptp(rows)
    wide = np.flatnonzero(
        steps > longest_interpolated_gap(source, float(np.median(steps)))
    )
    return [(float(time[k]), float(time[k + 1])) for k in wide]
