"""Selection of linearly independent columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.parameters.regroup import orthogonal_part


def independent_columns(matrix: Array, order: Sequence[int]) -> list[int]:
    """Indices of columns that span the column space, by thresholded Gram-Schmidt.

    Columns are tested in order of preference. A column is selected if its component orthogonal to
    the columns selected before is longer than a threshold: 0.3 in the first pass, then 0.03, 1e-3
    and 1e-6, until the rank is reached.

    Args:
        matrix: Matrix of full row rank, (k, p).
        order: Indices of columns in order of preference.
    """
    chosen: list[int] = []
    basis = np.zeros((0, len(matrix)))
    for threshold in (0.3, 0.03, 1e-3, 1e-6):
        for k in order if len(chosen) < len(matrix) else ():
            residual = orthogonal_part(matrix[:, k], basis)
            length = np.linalg.norm(residual)
            if length > threshold:
                chosen.append(k)
                basis = np.vstack([basis, residual / length])
    return chosen
