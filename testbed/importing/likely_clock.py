"""What column of a foreign file is likely its clock, in which unit, and at which rate it ticks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.errors import round_significant
from testbed.importing.column_names import without_unit
from testbed.importing.foreign_table import TIMES, ForeignTable, plain
from testbed.importing.known_layouts import LoggerLayout
from testbed.importing.source_clock import GAP, Times, steady_line

EPOCH = 1e9
"""Seconds since 1970 are one to three times as many: times of that size show their unit."""

USUAL = (20.0, 10_000.0)
"""Samples a second of most devices: they show the unit of steps [Hz]."""

TIME_WORDS = ("stamp", "time", "zeit", "received", "date", "sec", "t")
"""Names of times, or parts of them; the likeliest first."""

RISING = 0.5
"""Part of the steps of a clock that go forward, at least."""

STANDING = 0.01
"""Part of the steps in which a clock stands from which it is coarser than the samples."""

LOOKED_AT = 3
"""Columns that are tried."""


@dataclass(frozen=True)
class LikelyClock:
    """Time column of a source, its unit and its sampling rate.

    Attributes:
        column: Of its times; None if none looks like it.
        unit: Of these; None if unknown.
        given: Whether the file itself says the unit.
        rate: Samples a second, as round as the stamps allow [Hz]; 0 if that is not known.
        because: What shows it, if neither the file nor a name does.
        steady: What shows that it is coarser than the samples, if it is.
    """

    column: str | None
    unit: str | None = None
    given: bool = False
    rate: float = 0.0
    because: str = ""
    steady: str = ""

    @property
    def seconds(self) -> float | None:
        """What one of `time` is [s]; None if that is not known."""
        if self.column is None:
            return 1 / self.rate if self.rate else None
        return None if self.unit is None else 1.0

    def time(self, table: ForeignTable, samples: int) -> Array:
        """Times, (M,): in seconds, or in the column's unit or in samples if that is unknown."""
        if self.column is None:
            return np.arange(samples, dtype=np.float64)
        since = Times.of(table.stamps(self.column), self.unit or "s").since
        return steady_line(since, np.arange(len(since)))[0] if self.steady else since

    def by_velocity(self, seconds: float) -> LikelyClock:
        """The clock if one of `time` is so many seconds, by velocities against positions."""
        because = "by velocity and position"
        if self.column is None:
            return replace(self, rate=rounded(1 / seconds, 0.01), because=because)
        unit = min(TIMES, key=lambda name: abs(np.log(TIMES[name] / seconds)))
        return replace(self, unit=unit, rate=self.rate / TIMES[unit], because=because)

    def said(self) -> Iterator[tuple[str, Any, str]]:
        """Keys of the source in a mapping, their values and what is said beside them."""
        if self.column is None:
            more = "; no single column is times" * bool(self.rate)
            yield "rate", self.rate, f"{self.because}{more}".removeprefix("; ")
            return
        yield "time", self.column, f"{self.rate:.9g} a second" if self.unit else ""
        if not self.given:
            yield (
                "time_unit",
                self.unit or "",
                self.because if self.unit else ", ".join(TIMES),
            )
        if self.steady:
            yield "steady", True, self.steady


def clock_of(
    table: ForeignTable,
    layout: LoggerLayout | None = None,
    rows: NDArray[np.bool_] | bool = True,
) -> LikelyClock:
    """Find the time column of a table, its unit and its sampling rate.

    Args:
        table: Of a file of another program.
        layout: Its logger's, if that is known.
        rows: Samples that count, (M,); default all.
    """
    known = layout.times(table.columns) if layout else []
    if layout and (layout.rate or len(known) > 1):
        because = f"of {layout.logger}"
        if known:
            seconds, rest = (table.stamps(each) for each in known)
            since = (seconds - seconds[0]) + (rest - rest[0]) * TIMES["ns"]
            return LikelyClock(
                None, rate=rate_of(since), because=f"by {' and '.join(known)}"
            )
        return LikelyClock(None, rate=layout.rate, because=because)
    units = {column: plain(table.unit(column) or "") for column in table.columns}
    timed = {column: unit for column, unit in units.items() if unit in TIMES}
    named = [c for c in table.columns if c in timed or like_time(c) < len(TIME_WORDS)]
    likely = known or sorted(named, key=like_time)
    for column in likely[:LOOKED_AT]:
        stamps = table.stamps(column)
        stamps = stamps[rows & np.isfinite(stamps)]
        if len(stamps) < 2:
            continue
        steps = np.diff(stamps)
        stands = 0.0 if (steps < 0).any() else float((steps == 0).mean())
        line, _, even = steady_line(
            (stamps - stamps[0]).astype(np.float64), np.arange(len(stamps))
        )
        coarse = STANDING < stands < 1 and even
        if not coarse and (steps > 0).mean() <= RISING:
            continue
        unit, because = timed.get(column), ""
        if unit is None:
            unit, because = _unit(column, line + stamps[0] if coarse else stamps)
        unit = (layout.unit if layout and known else None) or unit
        one, steady = TIMES.get(unit or "", 1.0), ""
        if coarse:
            rate = rounded(1 / (one * float(line[1] - line[0])), 2 / len(stamps))
            steady = f"{stands:.0%} of the stamps are those before, as of a clock that ticks slower"
        else:
            rate = rounded(rate_of(stamps) / one, 1e-12 if unit else 0.0)
        return LikelyClock(column, unit, column in timed, rate, because, steady)
    count = max(table.lengths.values(), default=0)
    return LikelyClock(
        None, because=f"no column of {count} numbers looks like times [Hz]"
    )


def like_time(column: str) -> int:
    """How little a name is one of times: its place among the words."""
    last = column.lower().rpartition("/")[2]
    for k, word in enumerate(TIME_WORDS):
        if word in last if len(word) > 1 else re.split(r"[^a-z0-9]", last)[0] == word:
            return k
    return len(TIME_WORDS) - (without_unit(column)[1] in TIMES)


def rate_of(stamps: Array | NDArray[np.int64]) -> float:
    """Samples in one unit of the stamps, as round as they allow.

    Args:
        stamps: (M,), increasing but for gaps and repeated ones.
    """
    since = (stamps - stamps[0]).astype(np.float64)
    steps = np.diff(since)
    steps = steps[steps > 0]
    typical = float(np.median(steps))
    grain = 1.0 if stamps.dtype.kind == "i" else float(np.spacing(np.abs(stamps).max()))
    near = steps[steps <= max(GAP * typical, typical + 1.5 * grain)]
    pieces = 1 + len(steps) - len(near)
    doubt = 2 * pieces * (grain + float(np.std(near))) / float(near.sum())
    return rounded(len(near) / float(near.sum()), doubt)


def rounded(value: float, doubt: float) -> float:
    """The number of fewest digits within a relative doubt."""
    for digits in range(1, 12):
        short = round_significant(value, digits)
        if abs(short / value - 1) <= doubt:
            return short
    return value


def _unit(column: str, stamps: Array | NDArray[np.int64]) -> tuple[str | None, str]:
    """The unit of times by their name, their size or their steps, and which of these showed it."""
    words = [plain(word) for word in re.findall(r"[A-Za-zµ]+", column)]
    named = [
        word for word in words if word in TIMES and (word != "min" or len(words) > 1)
    ]
    if named:
        return named[-1], ""
    typical = float(np.median(np.abs(stamps)))
    sized = [
        u for u in ("s", "ms", "us", "ns") if EPOCH < typical * TIMES[u] < 3 * EPOCH
    ]
    if sized:
        return sized[0], "by its size"
    steps = np.diff(stamps)
    step = float(np.median(steps[steps > 0]))
    usual = [
        u
        for u in ("s", "ms", "us", "ns", "day")
        if USUAL[0] <= 1 / (step * TIMES[u]) <= USUAL[1]
    ]
    return (usual[0], "by its steps") if len(usual) == 1 else (None, "")
