"""When the samples of a source were taken: its clock, its silences, its repetitions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import RecordingError, plural
from testbed.importing.foreign_table import TIMES
from testbed.importing.mapping import SourceTable

BRIDGED, BRIDGED_SAMPLES = 0.1, 3.0
"""Longest gap that is bridged unless the mapping says otherwise [s], in samples if that is more."""

GAP = 1.5
"""Sampling times from which a step is a gap."""

STRAY = 0.5
"""Sampling times by which stamps, smoothed, may stray from a line if the device is steady."""

SMOOTHED = 101
"""Stamps over which jitter is averaged out."""

MINUTE = TIMES["min"]
"""A whole number of all units of time [s]."""

LONGEST, SHORTEST = 1e9, 1e-9
"""Sampling times beyond these are a mistake [s]."""


def longest_bridged(table: SourceTable, typical: float) -> float:
    """Longest time without samples that splines bridge [s].

    Args:
        table: What the mapping says of the source.
        typical: Its sampling time [s].
    """
    return table.max_gap or max(BRIDGED, BRIDGED_SAMPLES * typical)


@dataclass(frozen=True)
class ClockReport:
    """What a source's stamps look like.

    Attributes:
        samples: Number of samples used.
        rate: Samples a second, by the median step [Hz].
        jitter: Standard deviation of the steps within gaps' limits, in steps.
        gaps: Steps of more than 1.5 sampling times.
        longest_gap: Longest step [s].
        repeated: Samples left out because stamp and values were those of the one before.
        lead: From its first sample to the origin of the recording's times [s].
        cut: Whether a last sample was incomplete and is left out.
        even: Whether the stamps can be those of a constant rate.
        missing: Samples that the gaps leave out, or that have no numbers.
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
class Times:
    """When samples were taken by a source's clock.

    Seconds since 1970 with nanoseconds have more digits than floating-point numbers: they are
    kept in two parts.

    Attributes:
        start: Whole minutes before the first sample [s].
        since: (M,) from there [s].
    """

    start: float
    since: Array

    @staticmethod
    def of(stamps: Array | NDArray[np.int64], unit: str) -> Times:
        """Of stamps as they are counted, (M,), in a unit of `TIMES`."""
        if unit == "day":
            return Times.of(np.asarray(stamps * TIMES[unit], dtype=np.float64), "s")
        minute = round(MINUTE / TIMES[unit])  # of these units
        first = stamps[np.isfinite(stamps)][:1]
        # never beyond the counters' range
        minutes = int(first[0] / minute) if len(first) else 0
        since = np.asarray(stamps - minutes * minute, dtype=np.float64)
        return Times(MINUTE * minutes, since * TIMES[unit])


def by_one_clock(
    times: Mapping[str, Times], offsets: Mapping[str, float]
) -> dict[str, Array]:
    """Times of several sources since an instant in common, (M,) each [s].

    Args:
        times: By the sources' own clocks.
        offsets: Added to each [s].
    """
    starts = (
        each.start + MINUTE * (offsets[name] // MINUTE) for name, each in times.items()
    )
    # what all have in common costs digits and says nothing
    start = max(0.0, min(starts))
    return {
        name: t.since + (t.start - start + offsets[name]) for name, t in times.items()
    }


def sample_times(
    name: str, table: SourceTable, stamps: Array | NDArray[np.int64], unit: str | None
) -> Times:
    """When samples were taken by a source's clock, without offset and skew.

    Args:
        name: Of the source.
        table: What the mapping says of it.
        stamps: Its column of times, (M,).
        unit: What the file says of the times' unit; None if nothing.

    Raises:
        RecordingError: The times are none, or their unit is not said or another.
    """
    known = unit if unit in TIMES else None
    if table.time_unit is None and known is None:
        raise RecordingError(f"sources.{name}: say `time_unit`: {', '.join(TIMES)}")
    if known is not None and table.time_unit not in (None, known):
        raise RecordingError(
            f"sources.{name}: the file says its times are in {known}, time_unit is "
            f"{table.time_unit}; leave time_unit out"
        )
    if not np.isfinite(stamps).any():
        raise RecordingError(f"sources.{name}: '{table.time}' holds no number")
    return Times.of(stamps, table.time_unit or known or "s")


def without_repeats(
    name: str, time: Array, values: Array, *, steady: bool = False
) -> NDArray[np.bool_]:
    """Whether a sample differs from the one before, (M,) of bool.

    Where values change while the stamps of a steady device stand, its clock is coarse: all are.

    Args:
        name: Of the source.
        time: (M,) [s].
        values: All used columns, (M, k).
        steady: Whether the device samples at a constant rate.

    Raises:
        RecordingError: Time stands or runs back, and it is no repetition.
    """
    steps = np.diff(time)
    again = (steps == 0) & (values[1:] == values[:-1]).all(axis=1)
    bad = ~again & ~(steps > 0)
    if steady and bad.any() and not (steps < 0).any():
        return np.ones(len(time), dtype=bool)
    if bad.any():
        k = int(np.argmax(bad))
        raise RecordingError(
            f"sources.{name}: time does not increase after sample {k} ({time[k]:.9g} s, then "
            f"{time[k + 1]:.9g} s), {int(bad.sum())} such; if the device samples at a constant "
            "rate, say `rate` instead of `time`"
        )
    return np.append(True, ~again)


def steady_times(name: str, time: Array, rows: NDArray[np.intp]) -> Array:
    """Equidistant times of stamps with jitter or coarse resolution, (M,) [s].

    Args:
        name: Of the source.
        time: The stamps, (M,) [s].
        rows: Places of the samples in the file, (M,): between them are samples without numbers,
            or of something else.

    Raises:
        RecordingError: The stamps do not lie along a line: samples are missing.
    """
    for numbers in (np.arange(len(time)), rows):
        line, stray, even = steady_line(time, numbers)
        if even:
            return line
    k = int(np.argmax(np.abs(stray)))
    raise RecordingError(
        f"sources.{name}: its stamps stray from those of a steady device by "
        f"{np.abs(stray).max():.3g} s near sample {k}: samples are missing, or leave out `steady`"
    )


def steady_line(time: Array, number: NDArray[Any]) -> tuple[Array, Array, bool]:
    """Fit a line to time stamps: line, deviations, whether a constant rate explains them.

    Stamps of a coarse clock stand and jump by its tick: the line is that of the jumps.

    Args:
        time: The stamps, (M,) [s].
        number: Numbers of the samples, (M,), as 0, 1, ....
    """
    jumps = np.flatnonzero(np.diff(time) > 0) + 1
    # a sample at which the clock jumps is late by less than a step
    if len(jumps) < len(time) - 1:
        slope, begin = _line(number[jumps], time[jumps])
        stray = time[jumps] - begin - slope * number[jumps]
        if slope > 0 and np.ptp(stray) <= 2 * slope:
            return begin + slope * number, stray, True
    slope, begin = _line(number, time)
    line: Array = begin + slope * number
    width = min(SMOOTHED, len(time))
    stray = np.convolve(time - line, np.ones(width) / width, mode="valid")
    return line, stray, slope > 0 and bool(np.abs(stray).max() <= STRAY * slope)


def _line(number: NDArray[Any], time: Array) -> tuple[float, float]:
    """Slope and intercept of the line through points."""
    if len(number) < 2:
        return 0.0, 0.0
    centred = number - number.mean()
    slope = float(centred @ (time - time.mean()) / (centred @ centred))
    return slope, float(time.mean() - slope * number.mean())


def clock_report(
    name: str, table: SourceTable, stamps: Array, time: Array, repeated: int
) -> ClockReport:
    """What stamps look like; their gaps are checked.

    Args:
        name: Of the source.
        table: What the mapping says of it.
        stamps: Before they were made steady, (M,) [s].
        time: As they are used, (M,) [s].
        repeated: Samples that were left out.

    Raises:
        RecordingError: There is no clock in it, or a gap is too long.
    """
    if len(time) < 4:
        raise RecordingError(
            f"sources.{name}: {plural(len(time), 'sample')}, which is no recording"
        )
    steps, used = np.diff(stamps), np.diff(time)
    typical = float(np.median(used))
    if not SHORTEST < typical < LONGEST:
        raise RecordingError(
            f"sources.{name}: {typical:.3g} s from sample to sample is no sampling time; "
            "check `time_unit`"
        )
    longest = float(used.max())
    if longest > longest_bridged(table, typical):
        k = int(np.argmax(used))
        raise RecordingError(
            f"sources.{name}: nothing was recorded for {longest:.3g} s after "
            f"{time[k] - time[0]:.6g} s; `testbed import` cuts it there, `start` and `stop` "
            f"take one part, `max_gap` = {longest:.3g} bridges it"
        )
    near = steps[steps <= GAP * typical]
    jitter = float(np.std(near) / typical) if len(near) else 0.0
    gaps = used > GAP * typical
    missing = int((np.round(used[gaps] / typical) - 1).sum())
    even = steady_line(stamps, np.arange(len(stamps)))[2]
    return ClockReport(
        len(time),
        1 / typical,
        jitter,
        int(gaps.sum()),
        longest,
        repeated,
        even=even,
        missing=missing,
    )


SHORTEST_PIECE = 1.0
"""What is left between two gaps is a recording from this on [s]."""

Window = tuple[float, float]
"""First and last instant [s]."""


def cut(
    window: Window, clocks: Sequence[tuple[str, SourceTable, Array, NDArray[np.intp]]]
) -> tuple[list[Window], list[Diagnostic]]:
    """Pieces of a window in which no source is silent for too long, and where it was cut.

    The whole window without a word where there is no gap, or no piece is long enough.

    Args:
        window: What is wanted.
        clocks: Of each signal: its source, what the mapping says of that, times (M,) [s] and
            places in the file (M,) of its samples.
    """
    gaps = {
        (*gap, name)
        for name, source, time, rows in clocks
        for gap in _gaps(source, time, rows)
    }
    windows, said, begin = [], [], window[0]
    for last, first, name in sorted(gaps):
        if first <= window[0] or last >= window[1]:
            continue
        windows.append((begin, last))
        begin = max(begin, first)
        said.append(diagnose("import.cut", name, first - last, begin=last - window[0]))
    windows.append((begin, window[1]))
    long = [each for each in windows if each[1] - each[0] >= SHORTEST_PIECE]
    if not said or not long:
        return [window], []
    if short := len(windows) - len(long):
        said.append(diagnose("import.short", plural(short, "piece"), SHORTEST_PIECE))
    return long, said


def without_gaps(
    source: SourceTable,
    time: Array,
    rows: NDArray[np.intp],
    part: slice,
    window: Window,
) -> slice:
    """A part without samples outside the window that lie beyond a gap.

    Args:
        source: What the mapping says of it.
        time: Of its samples, (M,) [s].
        rows: Their places in the file, (M,).
        part: The samples in the window, and some around.
        window: What is wanted.
    """
    first, stop = part.start, part.stop
    for before, after in _gaps(source, time, rows):
        if after <= window[0]:
            first = max(first, int(np.searchsorted(time, after)))
        if before >= window[1]:
            stop = min(stop, int(np.searchsorted(time, before, side="right")))
            break
    return slice(first, stop)


def _gaps(source: SourceTable, time: Array, rows: NDArray[np.intp]) -> list[Window]:
    """Times of the samples on either side of each gap [s].

    Late stamps of a steady device are no gap, but samples without numbers are.
    """
    steps = np.diff(time)
    if source.steady:
        steps = np.diff(rows) * np.ptp(time) / np.ptp(rows)
    wide = np.flatnonzero(steps > longest_bridged(source, float(np.median(steps))))
    return [(float(time[k]), float(time[k + 1])) for k in wide]
