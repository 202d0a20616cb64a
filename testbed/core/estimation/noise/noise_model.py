"""What residuals are like: their noise, the period that they repeat with, a delay in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from testbed.core.base.arrays import Array
from testbed.core.estimation.noise.lagged_products import (
    Autoregression,
    prediction_errors,
)
from testbed.core.estimation.noise.whitening import WhitenedRows

ALIKE = 1e-3
"""Mean square of the difference to one period before, relative to that of far instants."""


def period_of(position: Array) -> int | None:
    """The shortest time after which a motion repeats, in samples; None if it does not.

    Only motions that are seen for one and a half periods at least can show one.

    Args:
        position: Encoders at evenly spaced times, (m, n) [rad or m].
    """
    # samples in which nothing repeats
    if len(position) < 4:
        return None
    spread = position.std(axis=0)
    # part of the largest joint's spread below which a joint shows little but noise
    moving = position[:, spread > 1e-2 * spread.max(initial=0.0)]
    if not moving.shape[1]:
        return None
    unit = (moving - moving.mean(axis=0)) / moving.std(axis=0)
    apart = _differences(unit)
    # where a motion has left its first pose: a period is more than standing still
    departed = np.flatnonzero(apart > 0.3)
    if not len(departed):
        return None
    near = np.flatnonzero(apart[departed[0] :] < ALIKE) + departed[0]
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
    return np.asarray(
        (later + earlier - 2 * products) / (2 * channels * (count - lags))
    )


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
            rows: Of one period; 0 for none.
            period: Of the motion [s].
        """
        channels = len(noise.sigma)
        self._noise, self._rows, self._period = noise, rows, period
        # residuals that the next ones are whitened with
        self._recent = np.zeros((channels, 0))
        self._before = np.zeros((channels, 0))  # whitened ones of one period
        self._sums = np.zeros((3, channels))
        self._pairs = 0

    def add(self, rows: WhitenedRows) -> None:
        """Go on with consecutive rows."""
        order = self._noise.order
        run = np.concatenate([self._recent, rows.white], axis=1)
        self._recent = run[:, max(0, run.shape[1] - order) :]
        alpha, count = prediction_errors(self._noise.coefficients), run.shape[1] - order
        if count <= 0 or not self._rows:
            return
        parts = (run[:, order - i : order - i + count] for i in range(order + 1))
        fresh = sum(alpha[:, i, None] * part for i, part in enumerate(parts))
        white = np.concatenate([self._before, fresh], axis=1)
        self._before = white[:, -self._rows :]
        now, then = white[:, self._rows :], white[:, : -self._rows]
        self._sums += [
            (now * then).sum(axis=1),
            (now**2).sum(axis=1),
            (then**2).sum(axis=1),
        ]
        self._pairs += now.shape[1]

    def result(self) -> PeriodicResidual | None:
        """What the sums say; None where the rows are too few."""
        products, *powers = self._sums
        size = np.sqrt(powers[0] * powers[1])
        some = size > 0
        # pairs of rows that the test needs: the sum of their products is then about normal
        if self._pairs < 30 or not some.any():
            return None
        share = products / np.where(some, size, 1.0)
        score = share[some] * np.sqrt(self._pairs)
        together = special.ndtr(-score.sum() / np.sqrt(len(score)))
        alone = len(score) * special.ndtr(-score.max())
        # two looks, and so many channels
        chance = min(1.0, 2 * float(min(together, alone)))
        return PeriodicResidual(self._period, tuple(float(x) for x in share), chance)


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """The noise that an estimate was made under.

    Attributes:
        order: Of each channel's autoregression; 0 where noise is taken as white.
        memory: Time in which the slowest part of each channel's noise fades to 1/e, (C,) [s].
        factor: By which sigma is larger than the formula's, found by a bootstrap.
        bias: Constants of the channels, with their weight, (C,) [N, N m]; zero if not looked for.
        bias_sigma: Their standard deviations, (C,).
        bias_chance: Probability of constants as large as these where there are none.
        bias_weight: Of the answer with constants, 0 to 1; the one without has the rest.
        span: How long the recording is [s].
        hidden: Parameters that no motion can separate from a constant of a channel.
        noise_limited: Parameters whose columns are in large part noise of the encoders, alone or
            together: sigma does not hold for them.
        least_counts: Of encoders that show whole counts and no noise between, zero for others,
            (n,) [rad or m]; empty if there are none.
        by_counts: Part of the whitened residuals that such counts account for.
        repetition: Whether the residuals repeat with the motion; None where that is unknown.
    """

    order: int
    memory: tuple[float, ...]
    factor: float
    bias: Array
    bias_sigma: Array
    bias_chance: float
    bias_weight: float
    span: float
    hidden: tuple[str, ...]
    noise_limited: tuple[str, ...] = ()
    least_counts: tuple[float, ...] = ()
    by_counts: float = 0.0
    repetition: PeriodicResidual | None = None

    @property
    def steps_matter(self) -> bool:
        """Whether steps of the encoders are much of what the model leaves."""
        # part of the whitened residuals that steps of the encoders may be without a word
        return self.by_counts > 0.05
