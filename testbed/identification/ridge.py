"""Ridge regression: estimates drawn towards zero where the data say little.

Source    A. E. Hoerl, R. W. Kennard, K. F. Baldwin [HKB75] for how far: as many times the noise's
          variance as there are parameters, over the square of the plain estimate
Scale     columns of unit length under the noise's own weights, as is usual there
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.arrays import Array
from testbed.diagnostics.diagnostic import diagnose
from testbed.identification.estimate import Estimate


def ridge(values: Array, covariance: Array) -> tuple[Array, Array]:
    """Values that are drawn towards zero, and their covariance without that bias.

    Args:
        values: Of the plain estimate, (p,).
        covariance: Of it, (p, p), positive definite.
    """
    sigma = np.sqrt(np.diagonal(covariance))
    inverse = np.linalg.inv(covariance / np.outer(sigma, sigma))
    length = np.sqrt(np.diagonal(inverse))  # of the columns, in units of 1 / sigma
    scale = length / sigma
    correlation = inverse / np.outer(length, length)
    scaled = values * scale
    strength = len(values) / float(scaled @ scaled)
    towards = np.linalg.solve(correlation + strength * np.eye(len(values)), correlation)
    shrink = towards * scale / scale[:, None]
    return shrink @ values, shrink @ covariance @ shrink.T


def shrink(estimate: Estimate, wanted: bool) -> Estimate:
    """An estimate by ridge regression, where that is wanted.

    Args:
        estimate: The plain one.
        wanted: Else it stays as it is.
    """
    if not wanted:
        return estimate
    values, covariance = ridge(estimate.values, estimate.covariance)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    said = (*estimate.diagnostics, diagnose("estimate.ridge"))
    return replace(estimate, values=values, sigma=sigma, covariance=covariance, diagnostics=said)
