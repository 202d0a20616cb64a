"""What errors of the plate's bodies do to a joint's regression, and back.

The torque that the bodies need is a column of the regression; where the plate knows them poorly,
that column holds errors, and the constant comes out too small.

Source    [Ful87] section 1.2
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.arrays import Array
from testbed.identification.estimate import Estimate
from testbed.identification.noise.fits import NoiseFit
from testbed.identification.regression.scaled import scaled_inverse

LEAST = 0.5
"""Reliability below which a constant is not told: most of its column may be error."""

TINY = float(np.finfo(float).tiny)
"""Against division by nothing."""


class AttenuationCorrection(NamedTuple):
    """A regression as it would be, were the bodies known exactly.

    Attributes:
        values: (1 + q,).
        covariance: Without what the bodies' own adds to first order, (1 + q, 1 + q).
        slope: How the values move with those before, (1 + q, 1 + q).
        reliability: Share of the constant that was left.
    """

    values: Array
    covariance: Array
    slope: Array
    reliability: float


def correct_attenuation(
    fit: NoiseFit, square: Array, doubt: tuple[float, float]
) -> AttenuationCorrection:
    """What errors of the bodies take of a constant is put back ([Ful87] section 1.2).

    A column with errors has more square than what it stands for, by `doubt` on average, and the
    coefficient is too small in proportion. What the doubt itself may be off counts in sigma.

    Args:
        fit: Of the columns as they are.
        square: Products of the columns, (1 + q, 1 + q).
        doubt: Mean and standard deviation of what errors add to the first column's square.
    """
    size = len(fit.values)
    alone = 1.0 / max(float(scaled_inverse(square)[0, 0]), TINY)  # square that terms do not show
    share, loose = doubt[0] / alone, doubt[1] / alone
    reliability = 1.0 - share
    kept = max(reliability, LEAST)
    toward = fit.covariance[:, 0] / max(float(fit.covariance[0, 0]), TINY)
    slope = np.eye(size) + np.outer(toward, np.eye(size)[0]) * (1 / kept - 1)
    values = slope @ fit.values
    unsure = loose / kept if reliability > LEAST else 1.0
    unsure *= abs(float(values[0])) if reliability > LEAST else max(1.0, abs(float(values[0])))
    return AttenuationCorrection(
        values,
        slope @ fit.covariance @ slope.T + unsure**2 * np.outer(toward, toward),
        slope,
        reliability,
    )


def doubt_about(normal: Array, lift: Array, bodies: Estimate) -> tuple[float, float]:
    """Mean and standard deviation of the square of what the bodies' errors make of a column."""
    spread = lift.T @ normal @ lift @ bodies.covariance
    return float(np.trace(spread)), float(np.sqrt(max(2 * np.trace(spread @ spread), 0.0)))
