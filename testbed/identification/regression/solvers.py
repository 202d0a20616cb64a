"""Ways to solve weighted least squares, one a file, the quickest first.

To add one, write a `Solver` in a file of its own and put it into SOLVERS.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from testbed.arrays import Array
from testbed.errors import UnknownName, UnseenParameters
from testbed.identification.regression.least_squares import Fit, Rows, Solver
from testbed.identification.regression.normal import by_normal_equations
from testbed.identification.regression.normal_equations import NormalEquations
from testbed.identification.regression.orthogonal import by_orthogonal_columns
from testbed.identification.regression.weights import noise_weights

SQUARED = 1e4
"""Condition up to which normal equations and one correction are as good as a QR."""

SOLVERS: tuple[tuple[Solver, float], ...] = (
    (by_normal_equations, SQUARED),
    (by_orthogonal_columns, np.inf),
)
"""Solvers, and the condition up to which each is trusted."""


def solve(equations: NormalEquations, weights: Array, rows: Rows) -> Fit:
    """The solution by the first solver that can be trusted with the equations' condition.

    Args:
        equations: Of all rows.
        weights: W, (C, C).
        rows: Starts a pass over all rows.

    Raises:
        UnseenParameters: The equations do not determine all unknowns; names them.
    """
    *quick, (last, _) = SOLVERS
    for solver, limit in quick:
        try:
            found = solver(equations, weights, rows)
        except UnseenParameters:  # to the precision of sums; the rows may know better
            continue
        if found.condition <= limit and not np.isnan(found.values).any():
            return found
    return last(equations, weights, rows)


def fit(equations: NormalEquations, weights: Mapping[str, float] | None = None) -> Fit:
    """Fit some of the channels, with weights of one's own.

    One channel alone, all but one, or any others: no pass over the samples.

    Args:
        equations: Of a recording; `Estimate.normal_equations`.
        weights: By channel, one over the variance of its noise [N^-2, (N m)^-2]; channels
            that are not named are left out. Default all, by their residuals.

    Raises:
        UnknownName: There is no such channel.
        UnseenParameters: The channels see parameters that they cannot tell apart.
    """
    if weights is None:
        chosen = noise_weights(equations, None)
    else:
        for name in weights:
            if name not in equations.channels:
                raise UnknownName("channel", name, equations.channels)
        chosen = np.diag([float(weights.get(c, 0.0)) for c in equations.channels])
    return by_normal_equations(equations, chosen, lambda combined: iter(()))
