"""What residuals are like: their noise, the period that they repeat with, a delay in them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from testbed.core.base.arrays import Array

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


def lag_of(position: Array, other: Array) -> float | None:
    """Samples by which another recording of a motion is behind; None if it is another motion.

    Args:
        position: Encoders at evenly spaced times, (m, n) [rad or m].
        other: The same of the other recording, (k, n).
    """
    centre, spread = position.mean(axis=0), position.std(axis=0)
    moving = spread > 1e-2 * spread.max(initial=0.0)
    if not moving.any():
        return None
    unit = (position - centre)[:, moving] / spread[moving]
    later = (other - centre)[:, moving] / spread[moving]
    curve = CubicSpline(np.arange(len(later)), later)

    def apart(lag: float) -> float:
        begin = max(0, math.ceil(-lag))
        end = min(len(unit), math.ceil(len(later) - lag))
        behind = curve(np.arange(begin, end) + lag)
        return float(np.square(unit[begin:end] - behind).mean()) / 2

    lags = np.arange(-len(unit) // 2, len(later) // 2 + 1)
    distances = [apart(float(lag)) for lag in lags]
    near = float(lags[np.argmin(distances)])
    found = minimize_scalar(apart, bounds=(near - 1, near + 1), method="bounded")
    return float(found.x) if found.fun < ALIKE else None


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
    def steps_matter(self) -> bool:
        """Whether steps of the encoders are much of what the model leaves."""
        # part of the whitened residuals that steps of the encoders may be without a word
        return self.by_counts > 0.05
