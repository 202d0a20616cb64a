"""What the first pass sees of the raw signals: some samples, evenly spread over the recording.

And how noisy the encoders are: differences of high order leave nothing of a motion. Encoders
that show whole counts, and no noise between, are distinguished from noisy ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import comb

import numpy as np

from testbed.arrays import Array
from testbed.kernel.records import Signals

SAMPLES = 20_000
"""How many are looked at, about: enough to see ranges and limits, few enough to cost nothing."""

ORDER = 8
"""Of the differences of positions: of a motion at a tenth of the sampling rate they leave 2 %."""

STRETCH = 256
"""Samples whose noise is averaged; of such means, the middle one counts: spikes are no noise."""


FEWEST = 16
"""Small changes of a position by which its least count is known."""

CLOSE = 0.1
"""Part of a count by which differences may be no whole counts: what rounding makes of them."""

WHOLE = 0.95
"""Part of the smallest differences that are whole counts, if a position is in counts."""

BETWEEN = 0.4
"""Counts of noise that blur the counts: of rounding alone there are 0.29 at most."""


@dataclass(frozen=True, eq=False)
class Repeats:
    """How often a sample is the same as the one before, while the encoders' are not.

    Attributes:
        steps: Pairs of samples whose encoders differ.
        channels: Of these, those in which a channel is the same, (C,).
        together: Those in which all channels are.
    """

    steps: int
    channels: Array
    together: int


@dataclass(frozen=True, eq=False)
class Survey:
    """Samples of the raw signals.

    Attributes:
        position: Encoders, (m, n) [rad or m].
        measured: Motor torques, (m, n) [N m or N], or the plate's wrench without its tare,
            (m, 6) [N, N m].
        repeats: How often samples are like the ones before, among all samples.
        encoder_noise: Standard deviations, as if it were white, (n,) [rad or m].
        encoder_count: Least count of encoders that show whole counts and no noise between; zero
            for others, (n,) [rad or m].
    """

    position: Array
    measured: Array
    repeats: Repeats
    encoder_noise: Array
    encoder_count: Array


class Surveyor:
    """Gathers a survey from windows, in whatever order they come."""

    def __init__(self, samples: int) -> None:
        """Nothing yet, of a recording of that many samples."""
        self.stride = max(1, samples // SAMPLES)
        self._kept: dict[int, tuple[Array, Array]] = {}
        self._repeats: dict[int, Repeats] = {}
        self._rough: dict[int, Array] = {}
        self._counts: dict[int, Array] = {}

    def look(self, signals: Signals, first: int, count: int, closely: bool = True) -> None:
        """Keep some of a window's samples.

        Args:
            signals: The window's.
            first: Number of its first sample.
            count: How many samples are its own: the next window has the others, too.
            closely: Whether its encoders' noise and counts are wanted: some windows show them.
        """
        own = slice(-first % self.stride, count, self.stride)
        self._kept[first] = signals.position[own].copy(), signals.measured[own].copy()
        self._repeats[first] = _repeats(
            signals.position[: count + 1], signals.measured[: count + 1]
        )
        if closely:
            self._rough[first] = _each(_noise_square, signals.position[: count + ORDER])
            self._counts[first] = _each(_least_count, signals.position[: count + 1])

    def survey(self) -> Survey:
        """All that was kept, in the order of time."""
        parts = [self._kept[first] for first in sorted(self._kept)]
        position, measured = (np.concatenate(group) for group in zip(*parts, strict=True))
        counts = self._repeats.values()
        repeats = Repeats(
            steps=sum(each.steps for each in counts),
            channels=np.sum([each.channels for each in counts], axis=0),
            together=sum(each.together for each in counts),
        )
        rough = np.stack([self._rough[first] for first in sorted(self._rough)])
        noise = np.sqrt(np.median(rough, axis=0))
        least = np.stack([self._counts[first] for first in sorted(self._counts)])
        return Survey(position, measured, repeats, noise, _without_noise(least, noise))


def _repeats(position: Array, measured: Array) -> Repeats:
    # a product of booleans is true where any is: ten times faster than `any` along short rows
    any_joint, any_channel = (np.ones(each.shape[1], np.bool_) for each in (position, measured))
    moved = (position[1:] != position[:-1]) @ any_joint
    same = measured[1:] == measured[:-1]
    same = same[moved & (same @ any_channel)]
    channels = same.sum(axis=0).astype(np.float64)
    together = len(same) - int(np.sum(~same @ any_channel))
    return Repeats(int(np.sum(moved)), channels, together)


def _each(number: Callable[[Array], float], position: Array) -> Array:
    """A number of every encoder, (n,): column by column, which fits into a cache."""
    return np.array([number(column) for column in np.ascontiguousarray(position.T)])


def _noise_square(position: Array) -> float:
    """Mean square of white noise in consecutive positions; zero where they are too few."""
    rough = np.diff(position, ORDER)
    if not len(rough):
        return 0.0
    starts = np.arange(0, max(len(rough) - STRETCH, 0) + 1, STRETCH)
    ends = np.append(starts[1:], len(rough))
    sums = np.add.reduceat(rough**2, starts) / (ends - starts)
    return float(np.median(sums)) / comb(2 * ORDER, ORDER)


def _least_count(position: Array) -> float:
    """Of consecutive positions; zero where there is none, nan where few differ a little."""
    changes = np.abs(np.diff(position))
    least = changes.min(initial=np.inf, where=changes > 0)
    few = changes[changes < 4.5 * least]
    few = few[few > 0]
    if len(few) < FEWEST:
        return float("nan")
    count = float(few[few < 1.5 * least].mean())
    whole = np.abs(few / count - np.round(few / count)) < CLOSE
    return count if whole.mean() >= WHOLE else 0.0


def _without_noise(counts: Array, noise: Array) -> Array:
    """Least counts of all windows, (windows, n), where noise, (n,), does not blur them."""
    found = np.zeros(len(noise))
    for joint, own in enumerate(counts.T):
        known = own[np.isfinite(own)]
        if len(known):
            found[joint] = np.median(known)
    return np.where(noise < BETWEEN * found, found, 0.0)
