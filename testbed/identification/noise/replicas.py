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
from testbed.identification.noise.autoregression import HIGHEST, Autoregression, NoiseMaker
from testbed.identification.noise.fits import Fit, NoiseFit
from testbed.identification.noise.lagged_products import LaggedProducts, LaggedSums

REPLICAS = 12
"""Replicas of the noise: with all parameters pooled, sigma is found to a few percent."""

SEED = 1996
"""Of the replicas: the same recording gives the same sigma."""


class Replicas:
    """Products of rows with replicas of their noise."""

    def __init__(self, noise: Autoregression, columns: int) -> None:
        """Nothing yet.

        Args:
            noise: What is to be made.
            columns: How many columns rows have.
        """
        self._columns, self._order = columns, noise.order
        self._maker = NoiseMaker(noise, REPLICAS, np.random.default_rng(SEED))
        self._sums = LaggedSums(HIGHEST)

    def add(self, columns: Array, ones: Array) -> None:
        """Go on with consecutive rows.

        Args:
            columns: Of the unknowns, (C, rows, m).
            ones: Where a row counts, (C, rows).
        """
        noise = self._maker.rows(columns.shape[1]) * ones[..., None]
        self._sums.add(np.concatenate([columns, noise, ones[..., None]], axis=2))

    def pause(self) -> None:
        """What comes next does not follow what came last."""
        self._sums.pause()

    def each(self, maps: Array | None = None) -> Iterator[LaggedProducts]:
        """Products with one replica after the other in the residuals' place.

        Args:
            maps: How columns and ones make up other columns, (C, m + 1, r); default as they are.
        """
        given, m = self._sums.finish(), self._columns
        if maps is not None:
            given, m = given.carrying(maps), maps.shape[2]
        for replica in range(REPLICAS):
            yield given.picked([*range(m), m + replica, m + REPLICAS])

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
