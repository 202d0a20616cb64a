"""How far a formula for sigma falls short, found by repeating the fit on made noise.

Noise that is fitted to residuals looks whiter than it is, the more so the more unknowns have
taken a part of it. A parametric bootstrap measures by how much: replicas of the found noise go
through the same fit, and their mean square in units of the formula's sigma is one if the
formula is right. It is pooled over parameters, since single ones would need many replicas.

Source    [ET93] for the bootstrap
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.arrays import Array
from testbed.identification.noise.autoregression import Autoregression, NoiseMaker
from testbed.identification.noise.fits import Fit, NoiseFit
from testbed.identification.noise.lagged_products import (
    LaggedProducts,
    LaggedSums,
    SymmetricProducts,
)

REPLICAS = 12
"""Replicas of the noise: with all parameters pooled, sigma is found to a few percent."""

SEED = 1996
"""Of the replicas: the same recording gives the same sigma."""


class Replicas:
    """Products of rows with replicas of their noise.

    Of columns with columns they are known from the residuals' own products.
    """

    def __init__(self, noise: Autoregression, known: LaggedProducts) -> None:
        """Nothing yet.

        Args:
            noise: What is to be made.
            known: Products of the rows' columns, residuals and ones.
        """
        self._order = noise.order
        columns = known.products.shape[2] - 2
        self._known = known.picked([*range(columns), columns + 1])
        self._maker = NoiseMaker(noise, REPLICAS, np.random.default_rng(SEED))
        self._noise = LaggedSums(known.lags)
        lags, channels = known.products.shape[:2]
        self._across = np.zeros((lags, channels, columns + 1, REPLICAS))
        self._before: tuple[Array, Array] | None = None

    def add(self, columns: Array, ones: Array) -> None:
        """Go on with consecutive rows.

        Args:
            columns: Of the unknowns, (C, rows, m).
            ones: Where a row counts, (C, rows).
        """
        noise = self._maker.rows(columns.shape[1]) * ones[..., None]
        self._noise.add(noise)
        now = np.concatenate([columns, ones[..., None]], axis=2), noise
        lags, rows = len(self._across) - 1, columns.shape[1]
        before = self._before or tuple(np.zeros((len(ones), lags, z.shape[2])) for z in now)
        columns, noise = (np.concatenate(each, axis=1) for each in zip(before, now, strict=True))
        for lag in range(lags + 1):  # as a lag's products and their transpose come together only
            late, early = slice(lags, lags + rows), slice(lags - lag, lags - lag + rows)
            self._across[lag] += columns[:, late].swapaxes(1, 2) @ noise[:, early] / 2
            self._across[lag] += columns[:, early].swapaxes(1, 2) @ noise[:, late] / 2
        self._before = columns[:, rows:], noise[:, rows:]

    def pause(self) -> None:
        """What comes next does not follow what came last."""
        self._noise.pause()
        self._before = None

    def each(self, maps: Array | None = None) -> Iterator[LaggedProducts]:
        """Products with one replica after the other in the residuals' place.

        Those of a lag are symmetric: half of what they are and of their transpose. They serve until
        the next replica takes their place.

        Args:
            maps: How columns and ones make up other columns, (C, m + 1, r); default as they are.
        """
        made, known, across = self._noise.finish(), self._known, self._across
        if maps is not None:
            whole = np.zeros((*maps.shape[:2], maps.shape[2] + 1))
            whole[..., :-1], whole[:, -1, -1] = maps, 1.0  # ones stay the last
            known, across = known.combined(whole), whole.swapaxes(1, 2) @ across
        size = across.shape[2] + 1
        others, own = np.array([*range(size - 2), size - 1]), size - 2
        first, last = (np.insert(each, own, 0.0, axis=3) for each in (known.first, known.last))
        lags, channels = across.shape[:2]
        products = np.zeros((channels, lags, size, size)).swapaxes(0, 1)
        within = known.symmetric.reshape(channels, lags, size - 1, size - 1)
        products[:, :, others[:, None], others] = within.swapaxes(0, 1)
        for replica in range(REPLICAS):
            products[:, :, own, others] = products[:, :, others, own] = across[..., replica]
            products[:, :, own, own] = made.products[:, :, replica, replica]
            first[..., own], last[..., own] = made.first[..., replica], made.last[..., replica]
            yield SymmetricProducts(made.rows, products, first, last)

    def factor(self, fit: Fit, lead: Array) -> float:
        """By how much sigma has to be multiplied: at least one.

        Args:
            fit: What found the noise.
            lead: How the rows' unknowns make up the parameters, (p, m).
        """
        squares = [_squares(fit(given, self._order), lead) for given in self.each()]
        return max(1.0, float(np.sqrt(np.mean(squares))))


def _squares(found: NoiseFit, lead: Array) -> Array:
    m = lead.shape[1]  # a fit may have unknowns of its own after these
    variance = np.einsum("pi,ij,pj->p", lead, found.covariance[:m, :m], lead)
    return np.asarray((lead @ found.values[:m]) ** 2 / np.maximum(variance, np.finfo(float).tiny))
