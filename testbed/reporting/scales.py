"""Where values stand along an axis of a figure, and the round values that are written there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array

STEPS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Between ticks, in powers of ten."""
STILL = 1e-12
"""Part of its size by which a value must change to be drawn as changing."""
ROOM = 0.05
"""Around a value that does not change, part of its size."""

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Scale:
    """One axis.

    Attributes:
        low: Value where it begins; may be above `high`.
        high: Value where it ends.
        log: Logarithmic: both are above zero.
    """

    low: float
    high: float
    log: bool = False

    @classmethod
    def of(cls, values: Array, room: float, log: bool = False) -> Scale:
        """The axis that values need.

        Args:
            values: Some of them perhaps not numbers, or without a logarithm.
            room: On either side, part of the axis that the values fill.
            log: Logarithmic.
        """
        there = values[np.isfinite(values) & ((values > 0) | (not log))]
        low, high = (float(there.min()), float(there.max())) if there.size else (1.0, 10.0)
        if log:
            low, high = np.log10([low, high]).tolist()
        size = max(abs(low), abs(high))
        if high - low <= STILL * size:
            low, high = low - ROOM * (size or 1.0), high + ROOM * (size or 1.0)
        low, high = low - room * (high - low), high + room * (high - low)
        return cls(10.0**low, 10.0**high, log) if log else cls(low, high)

    @property
    def decades(self) -> Scale:
        """The same of a logarithmic axis from one power of ten to another."""
        low, high = (f(np.log10(end)) for f, end in ((np.floor, self.low), (np.ceil, self.high)))
        return Scale(10.0**low, 10.0 ** max(high, low + 1), True)

    def part(self, values: Array) -> Array:
        """How far along the axis values stand, 0 to 1; nan for what has no place."""
        low, high = self.low, self.high
        if self.log:
            values = np.log10(np.where(values > 0, values, np.nan))
            low, high = np.log10([low, high]).tolist()
        return np.asarray((values - low) / (high - low))

    def ticks(self, most: int) -> Array:
        """Round values: two or more, and about `most`; on a logarithmic axis, powers of ten."""
        if self.log:
            ends = np.log10([self.low, self.high])
            powers = np.arange(np.ceil(ends[0] - STILL), np.floor(ends[1] + STILL) + 1)
            return np.asarray(10.0 ** powers[:: len(powers) // (most + 1) + 1])
        wanted = (self.high - self.low) / most
        steps = 10.0 ** np.floor(np.log10(wanted)) * np.array(STEPS)
        first, last = np.ceil(self.low / steps), np.floor(self.high / steps)
        enough = last > first
        chosen = int(np.argmax(enough & (steps >= wanted * (1 - STILL))))  # 0 where there is none
        if chosen == 0:
            chosen = int(np.flatnonzero(enough)[-1])
        numbers = np.arange(first[chosen], last[chosen] + 1) + 0.0  # no zero with a sign
        return np.asarray(steps[chosen] * numbers[:: 1 + (len(numbers) > most + 1)])

    def minor(self, ticks: Array) -> Array:
        """Values between a logarithmic axis' ticks that are marked: none where it skips powers."""
        if not self.log or len(ticks) < 2 or ticks[1] > 10.1 * ticks[0]:
            return np.zeros(0)
        every = np.outer([ticks[0] / 10, *ticks], np.arange(2, 10)).ravel()
        return every[(every >= self.low) & (every <= self.high)]

    def label(self, tick: float) -> str:
        """What is written at a tick."""
        return power_of_ten(tick) if self.log else tick_label(tick)


def tick_label(value: float) -> str:
    """A tick of an even axis: 0.02, -150, and 2·10⁻⁵ where zeros would be counted."""
    number, _, power = f"{value:g}".partition("e")
    if power:
        number += f"·10{str(int(power)).translate(_SUPERSCRIPTS)}"
    return number.replace("-", "−")


def power_of_ten(value: float) -> str:
    """A tick of a logarithmic axis: 0.01, 1, 100, and 10⁻⁵ where zeros would be counted."""
    power = round(float(np.log10(value)))
    if -3 <= power <= 3:
        return f"{10.0**power:g}"
    return f"10{str(power).translate(_SUPERSCRIPTS)}"
