"""Bootstrap replicas of noise and of encoder quantisation, and their effect on the unknowns.

Source    [ET93] for the bootstrap
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.stages import timed_stage
from testbed.core.estimation.noise.fits import FitFunction, NoiseFit
from testbed.core.estimation.noise.lagged_products import (
    Autoregression,
    LaggedProducts,
    LaggedSums,
    NoiseGenerator,
)
from testbed.core.estimation.noise.whitening import WhitenedRows
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE

REPLICA_COUNT = 12
"""Number of noise replicas: with all parameters pooled, sigma is accurate to a few percent."""

REPLICA_SEED = 1996
"""Seed of the replicas: the same recording gives the same sigma."""


class Replicas:
    """Lagged products of rows with simulated noise in place of the residuals."""

    def __init__(self, noise: Autoregression, seed: int = REPLICA_SEED) -> None:
        """Start with zero sums.

        Args:
            noise: Autoregression to simulate.
            seed: Seed of the replicas.
        """
        self._generator = NoiseGenerator(
            noise, REPLICA_COUNT, np.random.default_rng(seed)
        )
        self._sums = LaggedSums(noise.order)

    def add(self, columns: Array, ones: Array) -> None:
        """Add a block of consecutive rows.

        Args:
            columns: Columns of the unknowns, (C, rows, m).
            ones: Row indicators, one for rows that are used, else zero, (C, rows).
        """
        counts = ones[..., None]
        noise = self._generator.rows(columns.shape[1]) * counts
        self._sums.add(np.concatenate([columns, noise, counts], axis=2))

    def end_sequence(self) -> None:
        """End the sequence: the next rows do not follow the last row."""
        self._sums.end_sequence()

    @property
    def products(self) -> LaggedProducts:
        """Lagged products of columns, replicas and row indicators."""
        return replace(self._sums.lagged_products(), responses=REPLICA_COUNT)

    def normalised_squares(
        self, fit_function: FitFunction, basis: Array, directions: Array | None = None
    ) -> Array:
        """Squared estimates from noise alone, divided by their formal variances, (R, p).

        Args:
            fit_function: Function that fitted the rows.
            basis: Map from the rows' unknowns to the parameters, (p, m).
            directions: Channel combinations with a constant offset, (C, k); None without constants.
        """
        products = self.products
        if directions is not None:
            products = products.with_constants(directions)
        return np.array(
            [
                _normalised_squares(fit, basis)
                for fit in fit_function(products, products.lags)
            ]
        )


def _normalised_squares(fit: NoiseFit, basis: Array) -> Array:
    """Squared parameters of a fit, divided by their formal variances, (p,).

    Args:
        fit: Fit of one replica.
        basis: Map from the rows' unknowns to the parameters, (p, m).
    """
    m = basis.shape[1]  # the fit may have constants after these unknowns
    variance = ((basis @ fit.covariance[:m, :m]) * basis).sum(axis=1)
    return np.asarray(
        (basis @ fit.values[:m]) ** 2 / np.maximum(variance, SMALLEST_POSITIVE)
    )


class Bootstrap:
    """Parametric bootstrap of the correction factor for standard deviations."""

    def __init__(
        self,
        noise: Autoregression,
        directions: Array,
        basis: Array,
    ) -> None:
        """Start without rows.

        Args:
            noise: Autoregression of the residuals.
            directions: Channel combinations with a constant offset, (C, k).
            basis: Map from the rows' unknowns to the parameters, (p, m).
        """
        self._directions, self._basis = directions, basis
        self._replicas = Replicas(noise)

    def add(self, rows: WhitenedRows) -> None:
        """Add a block of consecutive rows."""
        self._replicas.add(rows.columns[..., : self._basis.shape[1]], rows.ones)

    @timed_stage("sigma from replicas of noise")
    def result(self, fit_function: FitFunction) -> float:
        """Correction factor for standard deviations, at least one.

        It is the RMS, over replicas and parameters, of estimates from noise alone divided by their
        formal standard deviations.

        Args:
            fit_function: Function that fitted the rows.
        """
        squares = self._replicas.normalised_squares(
            fit_function, self._basis, self._directions
        )
        return max(1.0, float(np.sqrt(np.mean(squares))))


class QuantizationSums:
    """Covariance due to encoder quantisation, from replicas of rounding errors."""

    def __init__(self, fit: NoiseFit, count: int) -> None:
        """Start with zero sums.

        Args:
            fit: Fit of the unknowns, which constants may follow.
            count: Number of unknowns, m.
        """
        self._fit, self._inverse = fit, fit.inverse[:count, :count]
        self._sums, self._rows = LaggedSums(fit.weighting.order), 0

    def add(self, rows: WhitenedRows) -> None:
        """Add a block of consecutive rows; blocks without noise columns are left out."""
        if rows.noise_columns.shape[2]:
            columns = rows.columns[..., : len(self._inverse)]
            self._sums.add(np.concatenate([columns, rows.noise_columns], axis=2))
            self._rows += rows.ones.size

    def result(self) -> tuple[Array, float]:
        """Covariance, (m, m), and fraction of squared whitened residuals due to quantisation.

        Both are zero without quantised encoders.
        """
        m = len(self._inverse)
        if not self._rows:
            return np.zeros((m, m)), 0.0
        squares = self._fit.normal(self._sums.lagged_products())
        errors = self._inverse @ squares[:m, m:]
        share = float(np.diagonal(squares)[m:].mean()) / self._rows
        return errors @ errors.T / errors.shape[1], share
