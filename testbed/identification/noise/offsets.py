"""A constant in every channel: where there is a bias, or where slow noise looks like one.

A constant that the parameters can imitate, such as the vertical force beside the total mass, is
not told apart by any motion and is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.blas import eigh
from testbed.identification.noise.fits import NoiseFit
from testbed.identification.noise.lagged_products import LaggedProducts
from testbed.identification.regression.scaled import scaled_solve

IMITATED = 1e-8
"""Share of a constant's square that the parameters leave of it if they cannot imitate it."""


@dataclass(frozen=True, eq=False)
class Constants:
    """Constants that no parameters can imitate.

    Attributes:
        directions: Combinations of the channels, (C, k), orthonormal.
        hidden: Unknowns that imitate the other constants, (C - k, m).
    """

    directions: Array
    hidden: Array


def constants(given: LaggedProducts) -> Constants:
    """Which constants can be told from the parameters.

    Args:
        given: Products of unknowns' columns, residuals and ones.
    """
    squares = given.products[0]
    m = squares.shape[2] - 2
    normal = squares[:, :m, :m].sum(axis=0)
    mixed = squares[:, :m, m + 1].T  # (m, C)
    counts = squares[:, m + 1, m + 1]
    imitating = scaled_solve(normal, mixed)
    left = np.diag(counts) - mixed.T @ imitating
    spread, axes = eigh((left + left.T) / 2)
    identifiable = spread > IMITATED * max(counts.max(initial=0.0), 1.0)
    return Constants(axes[:, identifiable], (imitating @ axes[:, ~identifiable]).T)


def square_of_last(found: NoiseFit, count: int) -> float:
    """How far the last `count` unknowns of a fit are from zero: a chi-square if they are."""
    if not count:
        return 0.0
    values, covariance = found.values[-count:], found.covariance[-count:, -count:]
    return float(values @ scaled_solve(covariance, values))
