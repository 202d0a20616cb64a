"""Noise in the columns of the equations: the bias that it and counts of encoders make."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.blas import eigh
from testbed.identification.noise.fits import NoiseFit
from testbed.identification.noise.lagged_products import LaggedProducts, LaggedSums
from testbed.identification.regression.scaled import square_root

MOST = 0.5
"""Part of the square of a combination of columns that may be noise: more is not taken back."""

NAMED = 0.25
"""Part of what tells a parameter that may be noise: taken back, but how well is not in sigma."""

ALL = 0.999
"""Part of what tells an unknown that noise is at most: all of it would leave no sigma."""


@dataclass(frozen=True, eq=False)
class AttenuationCorrection:
    """Unknowns as they were without noise in the columns.

    Attributes:
        found: Values and covariance.
        directions: Combinations of the unknowns, of normal matrix one before, (m, m).
        share: Part of the square of each one's column that is noise, (m,).
    """

    found: NoiseFit
    directions: Array
    share: Array

    def noise_limited(self, lead: Array) -> NDArray[np.bool_]:
        """Parameters that columns tell of which more than `NAMED` is noise, (p,).

        Args:
            lead: How the unknowns make up the parameters, (p, m).
        """
        parts = (lead @ self.directions) ** 2
        rest = 1 - np.clip(self.share, 0.0, ALL)
        return np.asarray(parts.sum(axis=1) < (1 - NAMED) * (parts / rest).sum(axis=1))


def correct_attenuation(found: NoiseFit, made: LaggedProducts) -> AttenuationCorrection:
    """Take noise in the columns back.

    Args:
        found: A fit.
        made: Products of noise in the same unknowns' columns, of what it leaves in the
            residuals, and of ones, as the rows' own.
    """
    m = len(found.values)
    white, root = found.normal(made), square_root(found.inverse)
    share, axes = eigh(root.T @ white[:m, :m] @ root)
    directions, kept = root @ axes, np.clip(share, 0.0, MOST)
    taken = white[:m, :m] @ found.values - white[:m, m]
    taken = directions.T @ taken * np.where(share > MOST, MOST / np.maximum(share, MOST), 1.0)
    spread = directions / (1 - kept)
    back = spread @ np.linalg.inv(directions)
    better = replace(
        found,
        values=found.values + spread @ taken,
        covariance=back @ found.covariance @ back.T,
        inverse=spread @ directions.T,
    )
    return AttenuationCorrection(better, directions, share)


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
