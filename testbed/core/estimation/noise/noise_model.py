"""Noise model of an estimate; period of a motion, and lag between two recordings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array

MAX_REPEAT_DIFFERENCE = 1e-3
"""Mean square of the difference to one period before, over that of distant instants, at most."""


def period_of(position: Array) -> int | None:
    """Period of a motion in samples, from encoder positions; None without a repetition.

    The period is the lag of the first minimum of the semivariogram below MAX_REPEAT_DIFFERENCE
    after a value above 0.3. Signals are scaled to unit variance, and joints with less than 1 % of
    the largest standard deviation are ignored. A period is detected only if the recording lasts at
    least one and a half periods.

    Args:
        position: Positions at evenly spaced times, (m, n) [rad or m].
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
    differences = _semivariogram(unit)
    # lags at which the motion has left its first pose: rest is no period
    departed = np.flatnonzero(differences > 0.3)
    if not len(departed):
        return None
    repeats = (
        np.flatnonzero(differences[departed[0] :] < MAX_REPEAT_DIFFERENCE) + departed[0]
    )
    if not len(repeats):
        return None
    first = int(repeats[0])
    departures = np.flatnonzero(differences[first:] >= MAX_REPEAT_DIFFERENCE)
    last = first + int(departures[0]) if len(departures) else len(differences)
    return first + int(np.argmin(differences[first:last]))


def lag_of(position: Array, other: Array) -> float | None:
    """Lag of a second recording of the same motion, in samples; None for another motion.

    Sample k of the first recording has the pose of sample k + lag of the second. The motions are
    the same if half the mean square difference, in units of each joint's variance, is below
    MAX_REPEAT_DIFFERENCE. Joints with less than 1 % of the largest standard deviation are ignored.

    Args:
        position: Positions at evenly spaced times, (m, n) [rad or m].
        other: Positions of the second recording, (k, n) [rad or m].
    """
    from scipy.interpolate import CubicSpline  # half a second, of rare use
    from scipy.optimize import minimize_scalar

    centre, spread = position.mean(axis=0), position.std(axis=0)
    moving = spread > 1e-2 * spread.max(initial=0.0)
    if not moving.any():
        return None
    unit = (position - centre)[:, moving] / spread[moving]
    later = (other - centre)[:, moving] / spread[moving]
    curve = CubicSpline(np.arange(len(later)), later)

    def difference(lag: float) -> float:
        begin = max(0, math.ceil(-lag))
        end = min(len(unit), math.ceil(len(later) - lag))
        behind = curve(np.arange(begin, end) + lag)
        return float(np.square(unit[begin:end] - behind).mean()) / 2

    lags = np.arange(-len(unit) // 2, len(later) // 2 + 1)
    distances = [difference(float(lag)) for lag in lags]
    nearest = float(lags[np.argmin(distances)])
    minimum = minimize_scalar(
        difference, bounds=(nearest - 1, nearest + 1), method="bounded"
    )
    return float(minimum.x) if minimum.fun < MAX_REPEAT_DIFFERENCE else None


def _semivariogram(unit: Array) -> Array:
    """Semivariogram by FFT: half the mean square of x_t - x_(t - lag).

    Lags run up to two thirds of the samples; the mean is over samples and signals.

    Args:
        unit: Signals with mean zero and variance one, (m, n).
    """
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


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise model under which an estimate was computed.

    Attributes:
        order: Order of each channel's autoregression; 0 for white noise.
        memory: Time in which the slowest mode of each channel's noise decays to 1/e, (C,) [s].
        factor: Ratio of the standard deviations from the bootstrap to the formal ones.
        bias: Constant offsets of the channels, times `bias_weight`, (C,) [N, N m]; zero if not
            estimated.
        bias_sigma: Standard deviations of the constant offsets, (C,) [N, N m].
        bias_chance: P-value of the constant offsets.
        bias_weight: Weight of the fit with constants in the average, 0 to 1.
        span: Duration of the recording [s].
        hidden: Parameters that no motion can separate from a constant channel offset.
        noise_limited: Parameters whose columns, alone or in combination, contain so much encoder
            noise that their standard deviations are unreliable.
        least_counts: Least counts of quantised encoders, zero for others, (n,) [rad or m]; empty if
            there are none.
        by_counts: Fraction of the whitened residuals' sum of squares due to quantisation.
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

    @property
    def quantization_matters(self) -> bool:
        """True if quantisation causes more than 5 % of the whitened residuals' sum of squares."""
        # part of the whitened residuals' squares above which there is a warning
        return self.by_counts > 0.05
