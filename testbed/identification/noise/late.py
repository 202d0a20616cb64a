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
from testbed.identification.noise.scaled import scaled_solve


@dataclass(frozen=True)
class Lateness:
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
) -> Lateness | None:
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
    now, one, two = given.products[:3]
    ones = np.maximum(now[:, -1, -1], 1.0)
    foretold = np.zeros((len(now), m + 2))
    foretold[:, :m] = start + found.values
    foretold[:, -1] = -np.einsum("ci,ci->c", now[:, -1], foretold) / ones  # its mean
    left = np.concatenate([-found.values, [1.0, 0.0]])
    rests = np.einsum("kcij,i,j->kc", given.products, left, left) / ones
    weights = 1 / np.maximum(rests[0], LEAST**2)
    before, after = one @ foretold[..., None], one.swapaxes(1, 2) @ foretold[..., None]
    slope = (after - before)[..., 0] * rate / 2  # with each column, (C, m + 2)
    squares = np.einsum("ci,cij,cj->c", foretold, now - two, foretold) * rate**2 / 2
    normal = np.tensordot(weights, now[:, :m, :m], 1)
    shared = weights @ slope[:, :m]
    alone = float(weights @ squares - shared @ scaled_solve(normal, shared))
    if alone <= 0:
        return None
    spread = _together(np.einsum("ci,kcij,cj->kc", foretold, given.products, foretold), rests)
    alike = max(float(weights**2 @ spread) * rate**2 / float(weights @ squares), 1.0)
    sigma = factor * float(np.sqrt(alike / alone))
    return Lateness(-float(weights @ slope @ left) / alone, sigma)


def _together(foretold: Array, rests: Array) -> Array:
    """Variance of the sum of slopes times residuals, over the rate squared, (C,).

    Args:
        foretold: Sums of what is foretold times itself so many rows later, (K + 1, C).
        rests: Means of residuals times residuals so many rows later, (K + 1, C).
    """
    mirrored = np.concatenate([foretold[2:0:-1], foretold])  # lags -2 ... K
    slopes = (2 * mirrored[2:-2] - mirrored[4:] - mirrored[:-4]) / 4  # lags 0 ... K - 2
    counted = np.where(np.arange(len(slopes)) == 0, 1.0, 2.0)
    return np.asarray(counted @ (slopes * rests[: len(slopes)]))
