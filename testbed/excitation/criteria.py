"""What makes one motion better than another: a number made of the unknowns' covariance.

C is the covariance of relative errors: of each parameter divided by the size of its value.
Every criterion is a logarithm, so that it falls by the same amount whatever the noise, and
belongs to a standard deviation: sigma = exp(value / 2).

    "a"   log of the mean of C's diagonal: the rms of relative sigmas
    "d"   log of the N-th root of det C: the volume of the ellipsoid
    "e"   log of C's largest eigenvalue: its longest axis. Where two axes are equally long that
          has a kink; the norm (mean of eigenvalues^p)^(1/p) of p = 8 stands for it

Source    optimality criteria: [Pukelsheim06] chapter 6
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeAlias

import numpy as np

from testbed.arrays import Array
from testbed.blas import eigh

Criterion: TypeAlias = Callable[[Array], tuple[float, Array]]
"""Of C, (N, N): the value, and its derivative by C, (N, N)."""

CriterionName = Literal["a", "d", "e"]

POWER = 8
"""Of the norm that stands for the largest eigenvalue."""


def a_optimal(covariance: Array) -> tuple[float, Array]:
    """Log of the mean variance, and its derivative."""
    count, trace = len(covariance), float(np.trace(covariance))
    return float(np.log(trace / count)), np.eye(count) / trace


def d_optimal(covariance: Array) -> tuple[float, Array]:
    """Log of the geometric mean of the variances along the axes, and its derivative."""
    count = len(covariance)
    size = float(np.linalg.slogdet(covariance)[1])
    return size / count, np.linalg.inv(covariance) / count


def e_optimal(covariance: Array) -> tuple[float, Array]:
    """Log of a smooth stand-in for the largest variance along an axis, and its derivative."""
    values, axes = eigh(covariance)
    share = np.maximum(values, 0.0) / values[-1]
    total = float(np.sum(share**POWER))
    value = float(np.log(values[-1]) + np.log(total / len(values)) / POWER)
    return value, (axes * (share ** (POWER - 1) / (total * values[-1]))) @ axes.T


CRITERIA: dict[CriterionName, Criterion] = {"a": a_optimal, "d": d_optimal, "e": e_optimal}
"""By name."""
