"""Measurements that are late against their columns: what is foretold moves on, the rest follows.

A signal that is late by d is short of what is foretold by d times its derivative. That is made of
the rows before and after, products of which are at hand: no other pass. Beside a row that was
dropped it is no derivative, but still no noise either, so that the test holds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.identification.noise.fits import LEAST, NoiseFit
from testbed.identification.noise.lagged_products import LaggedProducts
from testbed.identification.regression.scaled import scaled_solve

ROUNDS = 3
"""Times that the delay and the noise beside it are found in turns."""


@dataclass(frozen=True)
class TimeDelay:
    """By how much all channels are late together.

    Attributes:
        delay: [s]; less than it is where many rows were dropped.
        sigma: Its standard deviation.
    """

    delay: float
    sigma: float

    @property
    def z(self) -> float:
        """In sigmas."""
        return self.delay / self.sigma


def lateness(
    given: LaggedProducts, found: NoiseFit, start: Array, factor: float, rate: float
) -> TimeDelay | None:
    """What the residuals hold of a delay; None where there are too few rows to say.

    Channels weigh by the residuals that they have, of which a model of the noise may explain any
    part. Sigma counts how residuals and slopes hang together over neighbouring rows.

    Args:
        given: Products of unknowns' columns, residuals of a first solution, and ones, two lags.
        found: What is added to the first solution, (m,).
        start: The first solution, (m,).
        factor: By which sigma is larger than a formula's.
        rate: Rows a second [Hz].
    """
    if given.lags < 2:
        return None
    m = len(start)
    ones = np.maximum(given.products[0, :, -1, -1], 1.0)
    predicted = np.zeros((len(ones), m + 2))
    predicted[:, :m] = start + found.values
    predicted[:, -1] = (
        -np.einsum("ci,ci->c", given.products[0, :, -1], predicted) / ones
    )  # its mean
    left = np.broadcast_to(np.concatenate([-found.values, [1.0, 0.0]]), predicted.shape)
    slopes = _differences(_differences(_lagged(given, predicted, predicted), 1), -1) * rate**2
    rests, across = _lagged(given, left, left), _differences(_lagged(given, left, predicted), 1)
    now, one = given.products[:2]
    before, after = one @ predicted[..., None], one.swapaxes(1, 2) @ predicted[..., None]
    slope = (after - before)[..., 0] * rate / 2  # with each column, (C, m + 2)
    squares = slopes[len(slopes) // 2]
    late = TimeDelay(0.0, 0.0)
    for _ in range(ROUNDS):  # what is left without the delay is noise
        noise = _without(rests, across * rate, slopes, late.delay) / ones
        weights = 1 / np.maximum(noise[len(noise) // 2], LEAST**2)
        late = _fitted(now[:, :m, :m], slope, squares, left[0], weights)
        if not np.isfinite(late.sigma):
            return None
    alike = float(weights**2 @ (slopes * noise).sum(axis=0))
    alike /= float(weights @ squares)
    return TimeDelay(late.delay, factor * late.sigma * float(np.sqrt(max(alike, 1.0))))


def _fitted(columns: Array, slope: Array, squares: Array, left: Array, weights: Array) -> TimeDelay:
    """The delay beside the unknowns by weighted least squares; sigma is infinite for none.

    Args:
        columns: Products of the unknowns' columns, (C, m, m).
        slope: Of slopes with every column, (C, m + 2).
        squares: Of slopes with themselves, (C,).
        left: What of the columns the residuals are, (m + 2,).
        weights: (C,).
    """
    shared = weights @ slope[:, : columns.shape[1]]
    normal = np.tensordot(weights, columns, 1)
    alone = float(weights @ squares - shared @ scaled_solve(normal, shared))
    if alone <= 0:
        return TimeDelay(0.0, np.inf)
    return TimeDelay(-float(weights @ slope @ left) / alone, 1 / float(np.sqrt(alone)))


def _lagged(given: LaggedProducts, now: Array, before: Array) -> Array:
    """Sums of one combination of columns times another, j = -K ... K rows before, (2K + 1, C).

    Args:
        given: The products.
        now: (C, q).
        before: (C, q).
    """
    forth, back = (
        (one * (given.products @ other[..., None])[..., 0]).sum(axis=2)
        for one, other in ((now, before), (before, now))
    )
    return np.concatenate([back[:0:-1], forth])


def _differences(sums: Array, way: int) -> Array:
    """The same sums with the second of the two (1), or the first (-1), as half differences."""
    return way * (sums[:-2] - sums[2:]) / 2


def _without(rests: Array, across: Array, slopes: Array, delay: float) -> Array:
    """Sums of residuals times residuals, j rows apart, a delay taken back, (2K - 3, C)."""
    inner = rests[2:-2] + delay * (across[1:-1] + across[::-1][1:-1])
    return np.asarray(inner + delay**2 * slopes)
