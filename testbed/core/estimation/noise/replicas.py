"""Replicas of noise, and of errors of whole counts: what they do to the unknowns.

Source    [ET93] for the bootstrap
"""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.stages import stage
from testbed.core.estimation.noise.fits import Fits, NoiseFit
from testbed.core.estimation.noise.lagged_products import (
    Autoregression,
    LaggedProducts,
    LaggedSums,
    NoiseMaker,
)
from testbed.core.estimation.noise.whitening import WhitenedRows
from testbed.core.estimation.regression.normal_equations import TINY

REPLICAS = 12
"""Replicas of the noise: with all parameters pooled, sigma is found to a few percent."""

SEED = 1996
"""Of the replicas: the same recording gives the same sigma."""


class Replicas:
    """Products of rows with replicas of their noise.

    Of columns with columns they are known from the residuals' own products.
    """

    def __init__(
        self, noise: Autoregression, known: LaggedProducts, seed: int = SEED
    ) -> None:
        """Nothing yet.

        Args:
            noise: What is to be made.
            known: Products of the rows' columns, residuals and ones.
            seed: Of the replicas.
        """
        self._order = noise.order
        columns = known.unknowns
        self._known = known.up_to(noise.order)
        self._maker = NoiseMaker(noise, REPLICAS, np.random.default_rng(seed))
        self._noise = LaggedSums(noise.order)
        lags, channels = self._known.products.shape[:2]
        self._across = np.zeros((lags, channels, columns + 1, REPLICAS))
        self._before: Array | None = None

    def add(self, columns: Array, ones: Array) -> None:
        """Go on with consecutive rows.

        Args:
            columns: Of the unknowns, (C, rows, m).
            ones: Where a row counts, (C, rows).
        """
        noise = self._maker.rows(columns.shape[1]) * ones[..., None]
        self._noise.add(noise)
        now = np.concatenate([columns, ones[..., None], noise], axis=2)
        lags, rows = len(self._across) - 1, columns.shape[1]
        if self._before is None:
            self._before = np.zeros((len(ones), lags, now.shape[2]))
        run = np.concatenate([self._before, now], axis=1)
        known, made = run[..., :-REPLICAS].swapaxes(1, 2), run[..., -REPLICAS:]
        # a lag's products with their transpose
        for lag, across in enumerate(self._across):
            late, early = slice(lags, lags + rows), slice(lags - lag, lags - lag + rows)
            across += (
                known[..., late] @ made[:, early] + known[..., early] @ made[:, late]
            ) / 2
        self._before = run[:, rows:]

    def pause(self) -> None:
        """What comes next does not follow what came last."""
        self._noise.pause()
        self._before = None

    @property
    def products(self) -> LaggedProducts:
        """Products with the replicas in the residuals' place, symmetric those of a lag, too."""
        made, m, across = self._noise.finish(), self._known.unknowns, self._across
        known = self._known.columns(np.r_[:m, m + 1])  # columns and ones
        products = [
            [_symmetric(known.products), across],
            [across.swapaxes(2, 3), _symmetric(made.products)],
        ]
        first, last = (
            np.concatenate(ends, axis=3)
            for ends in ((known.first, made.first), (known.last, made.last))
        )
        whole = LaggedProducts(
            made.rows, np.block(products), first, last, REPLICAS, alike=True
        )
        return whole.columns(np.r_[:m, m + 1 : m + 1 + REPLICAS, m])

    def squares(
        self, fits: Fits, basis: Array, directions: Array | None = None
    ) -> Array:
        """Squares of parameters that are zero, as replicas have them, over sigma's, (R, p).

        Args:
            fits: Function that fitted the rows.
            basis: Parameters from the rows' unknowns, (p, m).
            directions: Combinations of the channels that are constants, (C, k); None for none.
        """
        products = self.products
        if directions is not None:
            products = products.with_constants(directions)
        return np.array([_squares(fit, basis) for fit in fits(products, self._order)])


def _symmetric(products: Array) -> Array:
    """Half of a lag's products and of their transpose."""
    return (products + products.swapaxes(2, 3)) / 2


def _squares(fit: NoiseFit, basis: Array) -> Array:
    m = basis.shape[1]  # a fit may have unknowns of its own after these
    variance = ((basis @ fit.covariance[:m, :m]) * basis).sum(axis=1)
    return np.asarray((basis @ fit.values[:m]) ** 2 / np.maximum(variance, TINY))


class Bootstrap:
    """Factor on standard deviations, from replicas of the noise."""

    def __init__(
        self,
        noise: Autoregression,
        products: LaggedProducts,
        directions: Array,
        basis: Array,
    ) -> None:
        """Nothing yet.

        Args:
            noise: Of the residuals.
            products: Of the rows' columns, residuals and ones.
            directions: Combinations of the channels that are constants, (C, k).
            basis: Parameters from the rows' unknowns, (p, m).
        """
        self._directions, self._basis = directions, basis
        self._replicas = Replicas(noise, products)

    def add(self, rows: WhitenedRows) -> None:
        """Go on with consecutive rows."""
        self._replicas.add(rows.columns[..., : self._basis.shape[1]], rows.ones)

    @stage("sigma from replicas of noise")
    def result(self, fits: Fits) -> float:
        """Factor of at least one.

        Args:
            fits: Function that fitted the rows.
        """
        squares = self._replicas.squares(fits, self._basis, self._directions)
        return max(1.0, float(np.sqrt(np.mean(squares))))


class QuantizationSums:
    """Covariance that whole counts of encoders cause, from replicas of their errors."""

    def __init__(self, fit: NoiseFit, count: int) -> None:
        """Nothing yet.

        Args:
            fit: Its unknowns may have constants after them.
            count: How many unknowns.
        """
        self._fit, self._inverse = fit, fit.inverse[:count, :count]
        self._sums, self._rows = LaggedSums(fit.weighting.order), 0

    def add(self, rows: WhitenedRows) -> None:
        """Go on with consecutive rows."""
        if rows.made.shape[2]:
            columns = rows.columns[..., : len(self._inverse)]
            self._sums.add(np.concatenate([columns, rows.made], axis=2))
            self._rows += rows.ones.size

    def result(self) -> tuple[Array, float]:
        """Covariance of the unknowns by counts alone, (m, m), and their part of the residuals."""
        m = len(self._inverse)
        if not self._rows:
            return np.zeros((m, m)), 0.0
        squares = self._fit.normal(self._sums.finish())
        moved = self._inverse @ squares[:m, m:]
        share = float(np.diagonal(squares)[m:].mean()) / self._rows
        return moved @ moved.T / moved.shape[1], share
