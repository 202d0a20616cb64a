"""Coloured noise as an autoregression, channel by channel: fitted, chosen, simulated.

e_t = a_1 e_(t-1) + ... + a_P e_(t-P) + u_t, u white. Fitted by least squares to products of
residuals with residuals before them.

Source    [BJRL16]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from testbed.arrays import Array

HIGHEST = 6
"""Largest order: half a second at ten rows a second; what lasts longer shows in the slowest."""

LARGEST_ROOT = 0.998
"""A fit may find noise that grows without end; it is held to one that forgets."""

RIDGE = 1e-12
"""Of the mean square: noise that repeats itself exactly has many autoregressions."""

BURN_IN = 200
"""Rows simulated before the first that counts."""


@dataclass(frozen=True, eq=False)
class Autoregression:
    """Noise of C channels.

    Attributes:
        coefficients: a, (C, P).
        sigma: Standard deviations of u, (C,).
    """

    coefficients: Array
    sigma: Array

    @property
    def order(self) -> int:
        """P."""
        return int(self.coefficients.shape[1])

    @property
    def memory(self) -> Array:
        """Rows in which the slowest part of each channel's noise fades to 1/e, (C,)."""
        kept = _largest_roots(self.coefficients)
        some = (kept > 0) & (kept < 1)
        return np.where(some, -1 / np.log(np.where(some, kept, 0.5)), 0.0)


def fit(moments: Array, order: int) -> Array:
    """Coefficients by least squares, (..., P), of noise that forgets.

    Args:
        moments: e_(t-i) e_(t-j) summed over the same t, (..., K + 1, K + 1), K >= P.
        order: P.
    """
    found = np.zeros((*moments.shape[:-2], order))
    matrix, right = moments[..., 1 : order + 1, 1 : order + 1], moments[..., 1 : order + 1, 0]
    size = np.trace(matrix, axis1=-2, axis2=-1)
    some = size > 0
    ridge = RIDGE * size[some, None, None] / max(order, 1) * np.eye(order)
    found[some] = np.linalg.solve(matrix[some] + ridge, right[some, :, None])[..., 0]
    return _forgetting(found)


def prediction_errors(coefficients: Array) -> Array:
    """1, -a_1 ... -a_P channel by channel, (..., P + 1): what makes white noise of the coloured."""
    return np.concatenate([np.ones((*coefficients.shape[:-1], 1)), -coefficients], axis=-1)


def innovation_variance(moments: Array, coefficients: Array) -> Array:
    """Sums of the squares of u, (...,).

    Args:
        moments: As for `fit`.
        coefficients: (..., P).
    """
    alpha, order = prediction_errors(coefficients), coefficients.shape[-1]
    part = moments[..., : order + 1, : order + 1]
    return np.asarray(np.einsum("...i,...ij,...j->...", alpha, part, alpha))


def best_order(moments: Array, rows: int, highest: int = HIGHEST) -> int:
    """The order, 1 to `highest`, by Akaike's criterion, the same for all channels.

    Args:
        moments: As for `fit`, K >= highest.
        rows: How many products are in each sum.
        highest: The largest to be tried.
    """
    scores = []
    for order in range(1, highest + 1):
        left = np.maximum(innovation_variance(moments, fit(moments, order)), np.finfo(float).tiny)
        scores.append(rows * np.log(left).sum() + 2 * order * len(moments))
    return 1 + int(np.argmin(scores))


def _largest_roots(coefficients: Array) -> Array:
    """How much of each channel's noise the slowest part of it keeps from row to row, (...,)."""
    order = coefficients.shape[-1]
    companion = np.zeros((*coefficients.shape, order))
    companion[..., :1, :] = coefficients[..., None, :]
    companion[..., range(1, order), range(order - 1)] = 1.0
    return np.asarray(np.abs(np.linalg.eigvals(companion)).max(axis=-1, initial=0.0))


def _forgetting(coefficients: Array) -> Array:
    """The same, with roots inside the unit circle, (..., P)."""
    largest = np.maximum(_largest_roots(coefficients), LARGEST_ROOT)[..., None]
    powers = np.arange(1, coefficients.shape[-1] + 1)
    return np.asarray(coefficients * (LARGEST_ROOT / largest) ** powers)


class NoiseMaker:
    """Replicas of noise, row after row."""

    def __init__(self, noise: Autoregression, replicas: int, rng: np.random.Generator) -> None:
        """Ready for the first row.

        Args:
            noise: What to make.
            replicas: How many at a time.
            rng: Random numbers.
        """
        self._noise, self._rng = noise, rng
        self._recent = np.zeros((len(noise.sigma), noise.order, replicas))
        self.rows(BURN_IN)

    def rows(self, count: int) -> Array:
        """The next rows, (C, count, replicas)."""
        order, sigma = self._noise.order, self._noise.sigma
        fresh = self._rng.normal(size=(count, len(sigma), self._recent.shape[2])) * sigma[:, None]
        made = np.concatenate([self._recent, fresh.transpose(1, 0, 2)], axis=1)
        for channel, alpha in enumerate(prediction_errors(self._noise.coefficients)):
            bands = np.repeat(alpha[:, None], order + count, axis=1)
            for back in range(1, order + 1):
                bands[back, : order - back] = 0.0  # what is made already stays
            made[channel], _ = lapack.dtbtrs(bands, made[channel], uplo="L", diag="U")
        self._recent = made[:, count:]
        return np.asarray(made[:, order:])
