"""What the first pass sees of the raw signals: some samples, evenly spread over the recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.kernel.records import Signals

SAMPLES = 20_000
"""How many are looked at, about: enough to see ranges and limits, few enough to cost nothing."""


@dataclass(frozen=True, eq=False)
class Survey:
    """Samples of the raw signals.

    Attributes:
        position: Encoders, (m, n) [rad or m].
        measured: Motor torques, (m, n) [N m or N], or the plate's wrench without its tare,
            (m, 6) [N, N m].
    """

    position: Array
    measured: Array


class Surveyor:
    """Gathers a survey from windows, in whatever order they come."""

    def __init__(self, samples: int) -> None:
        """Nothing yet, of a recording of that many samples."""
        self.stride = max(1, samples // SAMPLES)
        self._kept: dict[int, tuple[Array, Array]] = {}

    def look(self, signals: Signals, first: int, count: int) -> None:
        """Keep some of a window's samples.

        Args:
            signals: The window's.
            first: Number of its first sample.
            count: How many samples are its own: the next window has the others, too.
        """
        own = slice(-first % self.stride, count, self.stride)
        self._kept[first] = signals.position[own].copy(), signals.measured[own].copy()

    def survey(self) -> Survey:
        """All that was kept, in the order of time."""
        parts = [self._kept[first] for first in sorted(self._kept)]
        position, measured = (np.concatenate(group) for group in zip(*parts, strict=True))
        return Survey(position, measured)
