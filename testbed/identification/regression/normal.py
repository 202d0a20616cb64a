"""Scaled normal equations by Cholesky: no pass over the rows.

Source    [FRS96] eq. (14); columns are scaled to unit length first
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from testbed.arrays import Array
from testbed.blas import eigh
from testbed.errors import UnseenParameters
from testbed.identification.regression.least_squares import Fit, Rows, refuse
from testbed.identification.regression.normal_equations import NormalEquations


def by_normal_equations(equations: NormalEquations, weights: Array, rows: Rows) -> Fit:
    """The solution for given weights; errors grow with the square of the condition.

    Args:
        equations: Of all rows.
        weights: W, (C, C).
        rows: Not looked at.

    Raises:
        UnseenParameters: The equations do not determine all they see; names them.
    """
    del rows
    matrix, vector = equations.matrix(weights), equations.vector(weights)
    scale = np.sqrt(np.diagonal(matrix))
    seen = scale > 0
    if not seen.any():
        names = equations.unknowns
        raise UnseenParameters(names, 0, len(names), int(equations.used.sum()))
    values, inverse = np.full(len(scale), np.nan), np.full(matrix.shape, np.nan)
    unit = matrix[np.ix_(seen, seen)] / np.outer(scale[seen], scale[seen])
    spread, directions = eigh(unit)
    lost = spread <= len(spread) * np.finfo(float).eps * spread[-1]
    names, used = tuple(np.array(equations.unknowns)[seen]), int(equations.used.sum())
    if lost.any():
        refuse(names, directions[:, lost].T, used)
    try:
        factor = linalg.cho_factor(unit)
    except linalg.LinAlgError:  # as near to lost as rounding tells
        refuse(names, directions[:, :1].T, used)
    scaled = linalg.cho_solve(factor, np.eye(len(unit))) / np.outer(scale[seen], scale[seen])
    inverse[np.ix_(seen, seen)] = scaled
    values[seen] = linalg.cho_solve(factor, vector[seen] / scale[seen]) / scale[seen]
    condition = float(np.sqrt(spread[-1] / spread[0]))
    return Fit(values, inverse, weights, condition, correctable=True)
