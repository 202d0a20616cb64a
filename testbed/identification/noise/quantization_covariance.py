"""How far errors of whole counts lead an estimate astray.

They are large where joints are slow, and repeat with the motion: six periods tell no more of them
than one. An autoregression knows neither. So errors of the same kind, from other zeros of the
counts, go through the fit, and their spread is added. What the residuals' noise has of them is
counted, too: sigma is too large by up to 1.4, not too small.
"""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.identification.noise.fits import NoiseFit
from testbed.identification.noise.lagged_products import LaggedSums


class QuantizationCovariance:
    """Products of rows with replicas of what counts do to them."""

    def __init__(self, found: NoiseFit, count: int) -> None:
        """Nothing yet.

        Args:
            found: The fit; its unknowns may have constants after them.
            count: How many unknowns.
        """
        self._fit, self._inverse = found, found.inverse[:count, :count]
        self._sums, self._numbers = LaggedSums(found.weighting.order), 0

    def add(self, columns: Array, made: Array) -> None:
        """Go on with consecutive rows.

        Args:
            columns: Of the unknowns, (C, rows, m).
            made: Replicas, (C, rows, k); none where there are no counts.
        """
        if not made.shape[2]:
            return
        self._sums.add(np.concatenate([columns, made], axis=2))
        self._numbers += columns.shape[0] * columns.shape[1]

    def found(self) -> tuple[Array, float]:
        """Covariance of the unknowns by counts alone, (m, m), and their part of the residuals."""
        m = len(self._inverse)
        if not self._numbers:
            return np.zeros((m, m)), 0.0
        squares = self._fit.normal(self._sums.finish())
        moved = self._inverse @ squares[:m, m:]
        share = float(np.diagonal(squares)[m:].mean()) / self._numbers
        return moved @ moved.T / moved.shape[1], share
