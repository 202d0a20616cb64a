"""Likely time column of a foreign table, with unit and sampling rate."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.errors import round_significant
from testbed.importing.column_names import split_unit
from testbed.importing.foreign_table import TIME_UNITS, ForeignTable, canonical_unit
from testbed.importing.known_layouts import LoggerLayout
from testbed.importing.source_clock import MIN_GAP_INTERVALS, SourceTimes, fit_time_line

MIN_EPOCH_SECONDS = 1e9
"""Smallest time stamp taken as seconds since 1970 [s]; the largest is three times as large."""

USUAL_RATES = (20.0, 10_000.0)
"""Range of sampling rates by which the unit of time steps is recognised [Hz]."""

TIME_WORDS = ("stamp", "time", "zeit", "received", "date", "sec", "t")
"""Words of time columns' names, the most likely first."""

MIN_RISING_SHARE = 0.5
"""Smallest share of increasing steps of a time column."""

MIN_STANDSTILL_SHARE = 0.01
"""Share of zero steps from which on a clock is coarser than the sampling."""

MAX_TRIED_COLUMNS = 3
"""Largest number of columns that are tried."""


@dataclass(frozen=True)
class LikelyClock:
    """Time column of a source, with unit and sampling rate.

    Attributes:
        column: Time column; None if no column resembles times.
        unit: Unit of the times; None if unknown.
        is_unit_stated: True if the file itself states the unit.
        rate: Sampling rate [Hz], or samples per unit of the column if the unit is unknown, with as
            few digits as the stamps allow; 0 if unknown.
        rate_evidence: Evidence for the unit or rate, if neither the file nor a name states it.
        coarseness_evidence: Evidence that the clock is coarser than the sampling; empty if it is
            not.
    """

    column: str | None
    unit: str | None = None
    is_unit_stated: bool = False
    rate: float = 0.0
    rate_evidence: str = ""
    coarseness_evidence: str = ""

    @property
    def seconds_per_unit(self) -> float | None:
        """Seconds in one unit of the times that method `time` returns; None if unknown."""
        if self.column is None:
            return 1 / self.rate if self.rate else None
        return None if self.unit is None else 1.0

    def time(self, table: ForeignTable, samples: int) -> Array:
        """Sample times, (M,) [s].

        Without a time column, the times are sample numbers; if the unit is unknown, they are in the
        column's unit. The times of a coarse clock are those on the line of `fit_time_line`.

        Args:
            table: Table with the time column.
            samples: Number of samples.
        """
        if self.column is None:
            return np.arange(samples, dtype=np.float64)
        since = SourceTimes.from_stamps(
            table.time_stamps(self.column), self.unit or "s"
        ).time_after_start
        return (
            fit_time_line(since, np.arange(len(since)))[0]
            if self.coarseness_evidence
            else since
        )

    def with_unit_by_velocity(self, seconds: float) -> LikelyClock:
        """Clock with the unit or rate that follows from velocities and positions.

        The known unit nearest in size is taken; without a time column, the rate is set instead.

        Args:
            seconds: Seconds in one unit of the times that method `time` returns.
        """
        because = "by velocity and position"
        if self.column is None:
            return replace(
                self, rate=shortest_decimal(1 / seconds, 0.01), rate_evidence=because
            )
        unit = min(TIME_UNITS, key=lambda name: abs(np.log(TIME_UNITS[name] / seconds)))
        return replace(
            self, unit=unit, rate=self.rate / TIME_UNITS[unit], rate_evidence=because
        )

    def mapping_keys(self) -> Iterator[tuple[str, Any, str]]:
        """Keys of the source's table in a mapping file, with values and comments."""
        if self.column is None:
            remark = "; no single column is times" * bool(self.rate)
            yield "rate", self.rate, f"{self.rate_evidence}{remark}".removeprefix("; ")
            return
        yield "time", self.column, f"{self.rate:.9g} a second" if self.unit else ""
        if not self.is_unit_stated:
            yield (
                "time_unit",
                self.unit or "",
                self.rate_evidence if self.unit else ", ".join(TIME_UNITS),
            )
        if self.coarseness_evidence:
            yield "steady", True, self.coarseness_evidence


def find_clock(
    table: ForeignTable,
    layout: LoggerLayout | None = None,
    rows: NDArray[np.bool_] | bool = True,
) -> LikelyClock:
    """Find the time column of a table, with unit and sampling rate.

    Columns with a unit of time or a word of `TIME_WORDS` are tried in the order of these words. The
    first column is taken that increases in more than half of its steps, or that contains repeated
    stamps of a coarse clock along a line. A known layout replaces this choice by its own columns or
    rate.

    Args:
        table: Table of a file of another program.
        layout: Layout of the logger; None if unknown.
        rows: Mask of the samples to be used, (M,); default: all.
    """
    time_columns = layout.time_columns(table.columns) if layout else []
    if layout and (layout.rate or len(time_columns) > 1):
        because = f"of {layout.logger}"
        if time_columns:
            seconds, nanos = (table.time_stamps(each) for each in time_columns)
            since = (seconds - seconds[0]) + (nanos - nanos[0]) * TIME_UNITS["ns"]
            return LikelyClock(
                None,
                rate=sampling_rate(since),
                rate_evidence=f"by {' and '.join(time_columns)}",
            )
        return LikelyClock(None, rate=layout.rate, rate_evidence=because)
    units = {
        column: canonical_unit(table.unit(column) or "") for column in table.columns
    }
    with_time_unit = {
        column: unit for column, unit in units.items() if unit in TIME_UNITS
    }
    with_time_name = [
        c
        for c in table.columns
        if c in with_time_unit or time_word_rank(c) < len(TIME_WORDS)
    ]
    candidates = time_columns or sorted(with_time_name, key=time_word_rank)
    for column in candidates[:MAX_TRIED_COLUMNS]:
        stamps = table.time_stamps(column)
        stamps = stamps[rows & np.isfinite(stamps)]
        if len(stamps) < 2:
            continue
        steps = np.diff(stamps)
        share = 0.0 if (steps < 0).any() else float((steps == 0).mean())
        line, _, is_line = fit_time_line(
            (stamps - stamps[0]).astype(np.float64), np.arange(len(stamps))
        )
        is_coarse = MIN_STANDSTILL_SHARE < share < 1 and is_line
        if not is_coarse and (steps > 0).mean() <= MIN_RISING_SHARE:
            continue
        unit, because = with_time_unit.get(column), ""
        if unit is None:
            unit, because = _time_unit(
                column, line + stamps[0] if is_coarse else stamps
            )
        unit = (layout.unit if layout and time_columns else None) or unit
        seconds_per_unit, steady = TIME_UNITS.get(unit or "", 1.0), ""
        if is_coarse:
            rate = shortest_decimal(
                1 / (seconds_per_unit * float(line[1] - line[0])), 2 / len(stamps)
            )
            steady = f"{share:.0%} of the stamps are those before, as of a clock that ticks slower"
        else:
            rate = shortest_decimal(
                sampling_rate(stamps) / seconds_per_unit, 1e-12 if unit else 0.0
            )
        return LikelyClock(
            column, unit, column in with_time_unit, rate, because, steady
        )
    count = max(table.lengths.values(), default=0)
    return LikelyClock(
        None, rate_evidence=f"no column of {count} numbers contains increasing times"
    )


def time_word_rank(column: str) -> int:
    """Rank of a column name among time columns, from 0 for the most likely word.

    A name without a word for time ranks last: its rank is the number of words, or one lower if the
    name has a unit of time.
    """
    name = column.lower().rpartition("/")[2]
    for k, word in enumerate(TIME_WORDS):
        if word in name if len(word) > 1 else re.split(r"[^a-z0-9]", name)[0] == word:
            return k
    return len(TIME_WORDS) - (split_unit(column)[1] in TIME_UNITS)


def sampling_rate(stamps: Array | NDArray[np.int64]) -> float:
    """Number of samples in one unit of the stamps, with few digits.

    The number has the fewest digits that the resolution and the scatter of the stamps permit.

    Args:
        stamps: Time stamps, (M,), increasing except for gaps and repetitions.
    """
    since = (stamps - stamps[0]).astype(np.float64)
    steps = np.diff(since)
    steps = steps[steps > 0]
    typical = float(np.median(steps))
    resolution = (
        1.0 if stamps.dtype.kind == "i" else float(np.spacing(np.abs(stamps).max()))
    )
    regular = steps[
        steps <= max(MIN_GAP_INTERVALS * typical, typical + 1.5 * resolution)
    ]
    pieces = 1 + len(steps) - len(regular)
    relative_error = (
        2 * pieces * (resolution + float(np.std(regular))) / float(regular.sum())
    )
    return shortest_decimal(len(regular) / float(regular.sum()), relative_error)


def shortest_decimal(value: float, relative_error: float) -> float:
    """Number with the fewest digits within a relative error of a value.

    Args:
        value: Number to be rounded.
        relative_error: Largest relative difference.
    """
    for digits in range(1, 12):
        rounded = round_significant(value, digits)
        if abs(rounded / value - 1) <= relative_error:
            return rounded
    return value


def _time_unit(
    column: str, stamps: Array | NDArray[np.int64]
) -> tuple[str | None, str]:
    """Unit of times, and the evidence for it; None and "" if unknown.

    The unit is taken from the column's name (without evidence), or else from the size of the stamps
    (1e9 to 3e9 s since 1970), or else from their steps, if exactly one unit gives a sampling rate
    of 20 to 10 000 Hz.
    """
    words = [canonical_unit(word) for word in re.findall(r"[A-Za-zµ]+", column)]
    named_units = [
        word
        for word in words
        if word in TIME_UNITS and (word != "min" or len(words) > 1)
    ]
    if named_units:
        return named_units[-1], ""
    typical = float(np.median(np.abs(stamps)))
    units_by_size = [
        u
        for u in ("s", "ms", "us", "ns")
        if MIN_EPOCH_SECONDS < typical * TIME_UNITS[u] < 3 * MIN_EPOCH_SECONDS
    ]
    if units_by_size:
        return units_by_size[0], "by its size"
    steps = np.diff(stamps)
    step = float(np.median(steps[steps > 0]))
    units_by_steps = [
        u
        for u in ("s", "ms", "us", "ns", "day")
        if USUAL_RATES[0] <= 1 / (step * TIME_UNITS[u]) <= USUAL_RATES[1]
    ]
    return (
        (units_by_steps[0], "by its steps") if len(units_by_steps) == 1 else (None, "")
    )
