"""What the first pass sees of the raw signals: some samples, evenly spread over the recording.

And how noisy the encoders are: differences of high order leave nothing of a motion. Encoders
that show whole counts, and no noise between, are distinguished from noisy ones.
"""

from __future__ import annotations

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

    def look(self, signals: Signals, first: int, count: int) -> None:
        """Keep some of a window's samples.

        Args:
            signals: The window's.
            first: Number of its first sample.
            count: How many samples are its own: the next window has the others, too.
        """
        own = slice(-first % self.stride, count, self.stride)
        self._kept[first] = signals.position[own].copy(), signals.measured[own].copy()
        self._repeats[first] = _repeats(
            signals.position[: count + 1], signals.measured[: count + 1]
        )
        self._rough[first] = _noise_squares(signals.position[: count + ORDER])
        self._counts[first] = _least_counts(signals.position[: count + 1])

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
    moved = (position[1:] != position[:-1]).any(axis=1)
    same = (measured[1:] == measured[:-1])[moved]
    channels = same.sum(axis=0).astype(np.float64)
    return Repeats(int(moved.sum()), channels, int(same.all(axis=1).sum()))


def _noise_squares(position: Array) -> Array:
    """Mean square of white noise in consecutive positions, (n,); zero where they are too few."""
    rough = np.diff(position, ORDER, axis=0)
    if not len(rough):
        return np.zeros(position.shape[1])
    starts = np.arange(0, max(len(rough) - STRETCH, 0) + 1, STRETCH)
    ends = np.append(starts[1:], len(rough))
    sums = np.add.reduceat(rough**2, starts, axis=0) / (ends - starts)[:, None]
    return np.asarray(np.median(sums, axis=0) / comb(2 * ORDER, ORDER))


def _least_counts(position: Array) -> Array:
    """Of consecutive positions, (n,); zero where there is none, nan where few differ a little."""
    return np.array([_least_count(column) for column in np.abs(np.diff(position, axis=0)).T])


def _least_count(changes: Array) -> float:
    least = changes[changes > 0].min(initial=np.inf)
    few = changes[(changes > 0) & (changes < 4.5 * least)]
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
