"""What whole counts do to positions, made again with other zeros of the counts.

An encoder that is coarse beside the motion stands still from sample to sample. Its error is no
white noise: it is slow where the joint is slow, and the same whenever the motion is. What the
filter on positions makes smooth is rounded again from another zero, drawn at random: an error of
the same kind, and none of the same numbers.
"""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.identification.regression.windows import Plan
from testbed.kernel.records import Signals

HELD = 1024
"""Samples after which zeros that change do so."""

SEED = 1948
"""Of the zeros: the same recording gives the same estimate."""


class Quantization:
    """Errors of encoders that show whole counts, at the rows of a window."""

    def __init__(self, plan: Plan, count: Array) -> None:
        """Ready for any window.

        Args:
            plan: The rows; they pass a low-pass.
            count: Least counts, (n,) [rad or m]; zero for encoders without such errors.
        """
        self._plan, self._coarse = plan, np.flatnonzero(count)
        self._joints, self._count = len(count), count[self._coarse]
        self._kernels = np.stack([np.convolve(taps, plan.weights) for taps in plan.taps])

    def changing(self, signals: Signals, first: int) -> Array:
        """Of positions, velocities and accelerations, from ever other zeros, (3, rows, n).

        Args:
            signals: The window's.
            first: Number of its first row.
        """
        smooth = self.smooth(signals)
        begin = first * self._plan.step
        blocks = np.arange(begin, begin + len(smooth)) // HELD
        samples = [self._drawn(SEED, int(block)) for block in range(blocks[0], blocks[-1] + 1)]
        return self.error(smooth, np.array(samples)[blocks - blocks[0]])

    def lasting(self, signals: Signals, replica: int) -> Array:
        """From zeros that stay: what repeats in the motion repeats in them, (3, rows, n).

        Args:
            signals: The window's.
            replica: Number of the zeros.
        """
        return self.error(self.smooth(signals), self._drawn(SEED + 1, replica))

    def smooth(self, signals: Signals) -> Array:
        """Positions of coarse encoders around the rows, without counts, (samples, coarse)."""
        last = signals.start + (signals.number - 1) * signals.step
        half = self._kernels.shape[1] // 2
        shown = signals.position[signals.start - half : last + half + 1, self._coarse]
        around = len(signals.weights) // 2
        ends = np.pad(shown, ((around, around), (0, 0)), "reflect", reflect_type="odd")
        return np.stack([np.convolve(own, signals.weights, "valid") for own in ends.T], axis=1)

    def error(self, smooth: Array, zeros: Array) -> Array:
        """What counts from some zeros add, behind the filters, (3, rows, n).

        Args:
            smooth: Positions, (samples, coarse).
            zeros: In counts, (samples, coarse) or (coarse,).
        """
        counts = smooth / self._count + zeros
        off = (np.round(counts) - counts) * self._count
        around = np.lib.stride_tricks.sliding_window_view(off, self._kernels.shape[1], axis=0)
        found = around[:: self._plan.step] @ self._kernels.T
        every = np.zeros((3, len(found), self._joints))
        every[:, :, self._coarse] = np.moveaxis(found, 2, 0)
        return every

    def _drawn(self, *seed: int) -> Array:
        return np.random.default_rng(seed).uniform(size=len(self._count))
