"""Whether what an estimate leaves repeats with the motion: then it is no noise.

A robot that goes through the same motion again shows the same errors of its model again, and
other noise. Residuals whitened by the noise's own autoregression are multiplied by those of one
period before; in mere noise these products cancel. No cause has to be thought of beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from testbed.arrays import Array
from testbed.identification.noise.autoregression import Autoregression, prediction_errors

FEWEST = 30
"""Pairs of rows that the test needs: the sum of their products is then about normal."""


@dataclass(frozen=True)
class PeriodicResidual:
    """Residuals held against those of one period before.

    Attributes:
        period: Of the motion [s].
        share: Part of each channel's whitened residuals, squared, that repeats, (C,); below
            zero by chance.
        chance: Probability, at most, of as much in one channel or in all together in mere noise.
    """

    period: float
    share: tuple[float, ...]
    chance: float


class PeriodicSums:
    """Products of whitened residuals with those of one period before, row after row."""

    def __init__(self, noise: Autoregression, rows: int, period: float) -> None:
        """Nothing yet; of memory for one period.

        Args:
            noise: Of the residuals.
            rows: Of one period.
            period: Of the motion [s].
        """
        channels = len(noise.sigma)
        self._noise, self._rows, self._period = noise, rows, period
        self._recent = np.zeros((channels, 0))  # residuals that the next ones are whitened with
        self._before = np.zeros((channels, 0))  # whitened ones of one period
        self._sums = np.zeros((3, channels))
        self._pairs = 0

    def add(self, left: Array) -> None:
        """Go on with consecutive rows' residuals, (C, rows)."""
        order = self._noise.order
        run = np.concatenate([self._recent, left], axis=1)
        self._recent = run[:, max(0, run.shape[1] - order) :]
        alpha, count = prediction_errors(self._noise.coefficients), run.shape[1] - order
        if count <= 0:
            return
        fresh = np.zeros((len(run), count))
        for i in range(order + 1):
            fresh += alpha[:, i, None] * run[:, order - i : order - i + count]
        white = np.concatenate([self._before, fresh], axis=1)
        self._before = white[:, max(0, white.shape[1] - self._rows) :]
        now, then = white[:, self._rows :], white[:, : -self._rows]
        self._sums += [(now * then).sum(axis=1), (now**2).sum(axis=1), (then**2).sum(axis=1)]
        self._pairs += now.shape[1]

    def found(self) -> PeriodicResidual | None:
        """What the sums say; None where the rows are too few."""
        products, *powers = self._sums
        size = np.sqrt(powers[0] * powers[1])
        some = size > 0
        if self._pairs < FEWEST or not some.any():
            return None
        share = products / np.where(some, size, 1.0)
        score = share[some] * np.sqrt(self._pairs)
        together = special.ndtr(-score.sum() / np.sqrt(len(score)))
        alone = len(score) * special.ndtr(-score.max())
        chance = min(1.0, 2 * float(min(together, alone)))  # two looks, and so many channels
        return PeriodicResidual(self._period, tuple(float(x) for x in share), chance)
