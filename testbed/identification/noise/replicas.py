"""How far a formula for sigma falls short, found by repeating the fit on made noise.

Noise that is fitted to residuals looks whiter than it is, the more so the more unknowns have
taken a part of it. A parametric bootstrap measures by how much: replicas of the found noise go
through the same fit, and their mean square in units of the formula's sigma is one if the
formula is right. It is pooled over parameters, since single ones would need many replicas.

Source    [ET93] for the bootstrap
"""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.identification.noise.autoregression import Autoregression, NoiseMaker
from testbed.identification.noise.fits import Fits, NoiseFit
from testbed.identification.noise.lagged_products import LaggedProducts, LaggedSums
from testbed.stages import stage

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
        columns = known.unknowns
        self._known = known.up_to(noise.order)
        self._maker = NoiseMaker(noise, REPLICAS, np.random.default_rng(SEED))
        self._noise = LaggedSums(noise.order)
        lags, channels = self._known.products.shape[:2]
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
        around = np.zeros((*noise.shape[:2], lags + 1, REPLICAS))
        for lag in range(lags + 1):  # as a lag's products and their transpose come together only
            late, early = slice(lags, lags + rows), slice(lags - lag, lags - lag + rows)
            around[:, late, lag] += noise[:, early] / 2
            around[:, early, lag] += noise[:, late] / 2
        found = columns.swapaxes(1, 2) @ around.reshape(*noise.shape[:2], -1)
        self._across += np.moveaxis(found.reshape(*found.shape[:2], lags + 1, -1), 2, 0)
        self._before = columns[:, rows:], noise[:, rows:]

    def pause(self) -> None:
        """What comes next does not follow what came last."""
        self._noise.pause()
        self._before = None

    @property
    def products(self) -> LaggedProducts:
        """Products with the replicas in the residuals' place, symmetric those of a lag, too."""
        made, known, across = self._noise.finish(), self._known, self._across
        lags, channels, count, _ = across.shape
        m, own, size = count - 1, slice(count - 1, -1), count + REPLICAS
        rest = [*range(m), -1]  # columns and ones
        products = np.empty((lags, channels, size, size))
        for lag in range(lags):
            for channel, each in enumerate(products[lag]):  # one by one: they fit into a cache
                before, beside = known.products[lag, channel], across[lag, channel]
                each[:m, :m] = _alike(before[:m, :m])
                each[:m, -1] = each[-1, :m] = (before[:m, -1] + before[-1, :m]) / 2
                each[-1, -1] = before[-1, -1]
                each[rest, own], each[own, rest] = beside, beside.T
                each[own, own] = _alike(made.products[lag, channel])
        first, last = (
            np.concatenate([old[..., :m], new, old[..., -1:]], axis=3)
            for old, new in ((known.first, made.first), (known.last, made.last))
        )
        return LaggedProducts(made.rows, products, first, last, REPLICAS, alike=True)

    @stage("sigma from replicas of noise")
    def factor(self, fits: Fits, lead: Array) -> float:
        """By how much sigma has to be multiplied: at least one.

        Args:
            fits: What found the noise.
            lead: How the rows' unknowns make up the parameters, (p, m).
        """
        squares = [_squares(found, lead) for found in fits(self.products, self._order)]
        return max(1.0, float(np.sqrt(np.mean(squares))))


def _alike(products: Array) -> Array:
    """Half of what a lag's products are and of their transpose."""
    return (products + products.T) / 2


def _squares(found: NoiseFit, lead: Array) -> Array:
    m = lead.shape[1]  # a fit may have unknowns of its own after these
    variance = ((lead @ found.covariance[:m, :m]) * lead).sum(axis=1)
    return np.asarray((lead @ found.values[:m]) ** 2 / np.maximum(variance, np.finfo(float).tiny))
