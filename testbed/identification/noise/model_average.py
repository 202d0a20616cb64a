"""A constant in every channel or none: the average of both models of the noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from testbed.arrays import Array
from testbed.blas import eigh
from testbed.identification.noise.errors_in_variables import (
    AttenuationCorrection,
    correct_attenuation,
)
from testbed.identification.noise.fits import Fits, NoiseFit, weighted_fits, whitened_fits
from testbed.identification.noise.lagged_products import LaggedProducts
from testbed.identification.regression.scaled import scaled_solve
from testbed.stages import stage

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
    """Which constants can be distinguished from the parameters.

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


FEW = 50
"""Rows below which constants are not looked for."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Unknowns, and then constants, of both models together.

    Attributes:
        found: Averaged; its noise is the likelier model's.
        fits: What fitted either.
        directions: Combinations of the channels that are constants, (C, k).
        hidden: Unknowns that imitate other constants, (C - k, m).
        alone: Without constants, noise in the columns taken back; None where none was known.
        weight: Of the model with constants, 0 to 1.
        square: How far constants are from zero: a chi-square if they are.
    """

    found: NoiseFit
    fits: Fits
    directions: Array
    hidden: Array
    alone: AttenuationCorrection | None = None
    weight: float = 0.0
    square: float = 0.0


@stage("fit under coloured noise")
def averaged_fit(given: LaggedProducts, made: LaggedProducts | None, whole: bool) -> Answer:
    """Unknowns by the fit that suits the rows, constants averaged where there are rows enough.

    Args:
        given: Products of unknowns' columns, residuals and ones.
        made: Of noise in the same places; None for none.
        whole: Whether no rows are missing.
    """
    none, m = np.zeros((given.products.shape[1], 0)), given.unknowns
    fits = whitened_fits if whole else weighted_fits
    (plain,) = fits(given)
    taken = None if made is None else correct_attenuation(plain, made)
    alone = plain if taken is None else taken.found
    answer = Answer(alone, fits, none, np.zeros((0, m)), taken)
    if not whole:
        return answer
    there = constants(given)
    answer = replace(answer, hidden=there.hidden)
    count = there.directions.shape[1]
    if given.rows < FEW or not count:
        return answer
    directions = there.directions
    (beside,) = whitened_fits(given.with_constants(directions))
    if made is not None:
        beside = correct_attenuation(beside, made.with_constants(directions)).found
    square = square_of_last(beside, count)
    weight = float(special.expit(square / 2 - count))
    return replace(
        answer,
        found=averaged(alone, beside, weight),
        directions=directions,
        weight=weight,
        square=square,
    )


def averaged(alone: NoiseFit, beside: NoiseFit, weight: float) -> NoiseFit:
    """Both answers; without constants they are zero, for sure.

    Args:
        alone: Without constants, (m,).
        beside: With them after the unknowns, (m + k,).
        weight: Of the latter.
    """
    m, every = len(alone.values), len(beside.values)
    values, covariance, inverse = np.zeros(every), *np.zeros((2, every, every))
    values[:m], covariance[:m, :m], inverse[:m, :m] = alone.values, alone.covariance, alone.inverse
    likelier = beside if weight > 0.5 else alone
    apart = beside.values - values
    return NoiseFit(
        values=values + weight * apart,
        covariance=(1 - weight) * covariance
        + weight * beside.covariance
        + weight * (1 - weight) * np.outer(apart, apart),
        noise=likelier.noise,
        weighting=likelier.weighting,
        inverse=(1 - weight) * inverse + weight * beside.inverse,
    )
