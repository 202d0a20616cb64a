"""What noise of the encoders does to the unknowns' columns, made with noise of the same size.

Columns are made of measured positions and their derivatives. Noise of the encoders is white;
after the filters on positions and on rows what is left of it is known, and moves the columns
as the joints' coordinates would. Noise that is made stands in for what cannot be seen.
"""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import linear
from testbed.dynamics.motion import Motion
from testbed.identification.windows import Plan
from testbed.kernel.records import Signals

PER_ROW = 5
"""Samples of made noise from row to row, at least: slow noise, behind the filter on rows."""

BLOCK = 1024
"""Samples of made noise that are drawn at once, from a seed of their own."""

SEED = 1997
"""Of the made noise: the same recording gives the same estimate."""


class NoisyColumns:
    """Noise in columns of the plate's rows, window by window, the same for any order of them."""

    def __init__(self, plan: Plan, sigma: Array, combined: Array) -> None:
        """Ready for any window.

        Args:
            plan: The rows.
            sigma: Standard deviations of the encoders' noise, (n,) [rad or m].
            combined: How the unknowns' columns are combined, (p, q).
        """
        self._plan, self._sigma = plan, sigma
        self._lead = plan.layout.theta @ (plan.layout.basis @ combined)
        divisors = [d for d in range(1, plan.step + 1) if plan.step % d == 0]
        stride = max([d for d in divisors if d * PER_ROW <= plan.step], default=1)
        kernels = np.stack([np.convolve(taps, plan.weights) for taps in plan.taps])
        middle = kernels.shape[1] // 2
        self._per_row = plan.step // stride
        self._kernels = kernels[:, middle % stride :: stride].T * np.sqrt(stride)

    def __call__(self, signals: Signals, first: int) -> Array:
        """Of a window's rows, (6, rows, q).

        Args:
            signals: The window's.
            first: Number of its first row.
        """
        layout, noise = self._plan.layout, self.coordinates(first, signals.number)
        half = signals.taps.shape[1] // 2
        around = np.lib.stride_tricks.sliding_window_view(signals.position, 2 * half + 1, axis=0)
        at = signals.start - half + np.arange(signals.number) * signals.step
        motion = np.moveaxis(around[at] @ signals.taps.T, 2, 0)
        moved = np.concatenate([motion + noise, motion - noise], axis=1)
        time = np.arange(moved.shape[1], dtype=np.float64)
        wrench = linear(layout.tree, Motion(time, *moved), self._lead, layout.gravity)[1]
        more, less = np.split(wrench, 2)
        return np.asarray((more - less).transpose(1, 0, 2) / 2)

    def coordinates(self, first: int, count: int) -> Array:
        """Made noise of positions, velocities and accelerations, filtered, (3, rows, n).

        Args:
            first: Number of the first row.
            count: How many rows.
        """
        begin = first * self._per_row
        end = (first + count - 1) * self._per_row + len(self._kernels)
        white = np.concatenate(
            [
                np.random.default_rng([SEED, block]).normal(size=(BLOCK, len(self._sigma)))
                for block in range(begin // BLOCK, -(-end // BLOCK))
            ]
        )[begin % BLOCK :][: end - begin]
        around = np.lib.stride_tricks.sliding_window_view(white, len(self._kernels), axis=0)
        made = around[:: self._per_row] @ self._kernels
        return np.asarray(np.moveaxis(made, 2, 0) * self._sigma)
