"""The period of a motion, and residuals that repeat with it: they are no noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from testbed.arrays import Array
from testbed.identification.noise.autoregression import Autoregression, prediction_errors

ALIKE = 1e-3
"""Mean square of the difference to one period before, relative to that of far instants."""

UNLIKE = 0.3
"""The same where a motion has left where it was: a period is more than standing still."""

AT_REST = 1e-2
"""Part of the largest joint's spread below which a joint shows little but noise."""

FEWEST_SAMPLES = 4
"""Samples in which nothing repeats."""


def period_of(position: Array) -> int | None:
    """The shortest time after which a motion repeats, in samples; None if it does not.

    Only motions that are seen for one and a half periods at least can show one.

    Args:
        position: Encoders at evenly spaced times, (m, n) [rad or m].
    """
    if len(position) < FEWEST_SAMPLES:
        return None
    spread = position.std(axis=0)
    moving = position[:, spread > AT_REST * spread.max(initial=0.0)]
    if not moving.shape[1]:
        return None
    unit = (moving - moving.mean(axis=0)) / moving.std(axis=0)
    apart = _differences(unit)
    left = np.flatnonzero(apart > UNLIKE)
    if not len(left):
        return None
    near = np.flatnonzero(apart[left[0] :] < ALIKE) + left[0]
    if not len(near):
        return None
    first = int(near[0])
    away = np.flatnonzero(apart[first:] >= ALIKE)
    last = first + int(away[0]) if len(away) else len(apart)
    return first + int(np.argmin(apart[first:last]))


def _differences(unit: Array) -> Array:
    """Mean square of x_t - x_(t - lag) over 2, for lags up to two thirds of the samples."""
    count, channels = unit.shape
    lags = np.arange(2 * count // 3 + 1)
    size = 1 << int(2 * count - 1).bit_length()
    spectrum = np.fft.rfft(unit, size, axis=0)
    products = np.fft.irfft((np.abs(spectrum) ** 2).sum(axis=1), size)[lags]
    ends = np.concatenate([[0.0], np.cumsum((unit**2).sum(axis=1))])
    later, earlier = ends[-1] - ends[lags], ends[count - lags]
    return np.asarray((later + earlier - 2 * products) / (2 * channels * (count - lags)))


FEWEST_PAIRS = 30
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
        if self._pairs < FEWEST_PAIRS or not some.any():
            return None
        share = products / np.where(some, size, 1.0)
        score = share[some] * np.sqrt(self._pairs)
        together = special.ndtr(-score.sum() / np.sqrt(len(score)))
        alone = len(score) * special.ndtr(-score.max())
        chance = min(1.0, 2 * float(min(together, alone)))  # two looks, and so many channels
        return PeriodicResidual(self._period, tuple(float(x) for x in share), chance)
