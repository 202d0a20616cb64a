"""The speed at which friction fades out, where the terms leave it open: an outer loop.

The internal fit is linear for any speed. Columns of many speeds are made in one pass; each fit has
those of one, and the best is looked for more closely in a second pass.
"""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.blas import one_blas_thread
from testbed.errors import round_significant
from testbed.identification.problem import Problem
from testbed.identification.regression.normal_equations import NormalEquations
from testbed.identification.regression.scaled import scaled_solve
from testbed.identification.regression.weights import noise_weights
from testbed.robot.friction import STRIBECK, stribeck

SPEEDS = tuple(np.geomspace(0.01, 1.0, 13).tolist())
"""First look [rad/s or m/s]."""

CLOSER = 9
"""Speeds of the second look, between the neighbours of the best."""


def with_stribeck_speed(problem: Problem) -> Problem:
    """A problem whose terms say the speed at which friction fades out, one for all joints.

    Args:
        problem: By joint torques, with "stribeck" among the terms.
    """

    def best(speeds: tuple[float, ...]) -> int:
        laws = (*problem.settings.words, *(stribeck(speed) for speed in speeds))
        every = problem.with_settings(terms=laws, weights="channels")
        with one_blas_thread():
            equations = every.equations(every.passes(1))
            costs = [_cost(_with_one(equations, every, speed)) for speed in speeds]
        return int(np.argmin(costs))

    first = best(SPEEDS)
    low, high = SPEEDS[max(first - 1, 0)], SPEEDS[min(first + 1, len(SPEEDS) - 1)]
    closer = tuple(round_significant(speed, 3) for speed in np.geomspace(low, high, CLOSER))
    found = f"{STRIBECK}@{closer[best(closer)]:g}"
    asked = problem.settings.terms or ()
    return problem.with_settings(terms=[found if term == STRIBECK else term for term in asked])


def _with_one(equations: NormalEquations, problem: Problem, speed: float) -> NormalEquations:
    """The equations with the columns of one speed alone."""
    ours, kind, count = stribeck(speed), f"{STRIBECK}@", problem.minimal.count
    kept = [*range(count)]
    for k, term in enumerate(problem.layout.terms, start=count):
        if not term.law.kind.startswith(kind) or term.law == ours:
            kept.append(k)
    return equations.of_unknowns(kept)


def _cost(equations: NormalEquations) -> float:
    """What likelihood says of the best fit: the less the better."""
    weights: Array = noise_weights(equations, None, False)
    values = scaled_solve(equations.matrix(weights), equations.vector(weights))
    left = np.diagonal(equations.residual(values)) / np.maximum(equations.used, 1.0)
    tiny = np.finfo(float).tiny
    return float(equations.used @ np.log(np.maximum(left, tiny)))
