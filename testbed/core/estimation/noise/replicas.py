"""Replicas of noise, and of errors of whole counts: what they do to the unknowns.

Source    [ET93] for the bootstrap
"""

from __future__ import annotations

from dataclasses import replace

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
    """Products of rows with replicas of their noise in the residuals' place."""

    def __init__(self, noise: Autoregression, seed: int = SEED) -> None:
        """Nothing yet.

        Args:
            noise: What is to be made.
            seed: Of the replicas.
        """
        self._maker = NoiseMaker(noise, REPLICAS, np.random.default_rng(seed))
        self._sums = LaggedSums(noise.order)

    def add(self, columns: Array, ones: Array) -> None:
        """Go on with consecutive rows.

        Args:
            columns: Of the unknowns, (C, rows, m).
            ones: Where a row counts, (C, rows).
        """
        counts = ones[..., None]
        noise = self._maker.rows(columns.shape[1]) * counts
        self._sums.add(np.concatenate([columns, noise, counts], axis=2))

    def pause(self) -> None:
        """What comes next does not follow what came last."""
        self._sums.pause()

    @property
    def products(self) -> LaggedProducts:
        """Products of columns, replicas and ones."""
        return replace(self._sums.finish(), responses=REPLICAS)

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
        return np.array([_squares(fit, basis) for fit in fits(products, products.lags)])


def _squares(fit: NoiseFit, basis: Array) -> Array:
    m = basis.shape[1]  # a fit may have unknowns of its own after these
    variance = ((basis @ fit.covariance[:m, :m]) * basis).sum(axis=1)
    return np.asarray((basis @ fit.values[:m]) ** 2 / np.maximum(variance, TINY))


class Bootstrap:
    """Factor on standard deviations, from replicas of the noise."""

    def __init__(
        self,
        noise: Autoregression,
        directions: Array,
        basis: Array,
    ) -> None:
        """Nothing yet.

        Args:
            noise: Of the residuals.
            directions: Combinations of the channels that are constants, (C, k).
            basis: Parameters from the rows' unknowns, (p, m).
        """
        self._directions, self._basis = directions, basis
        self._replicas = Replicas(noise)

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
