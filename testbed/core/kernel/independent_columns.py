"""Columns of a matrix that span all others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.parameters.regroup import beyond


def independent_columns(matrix: Array, order: Sequence[int]) -> list[int]:
    """Columns that span all others, earlier ones preferred unless nearly dependent."""
    picked: list[int] = []
    basis = np.zeros((0, len(matrix)))
    for threshold in (0.3, 0.03, 1e-3, 1e-6):
        for k in order if len(picked) < len(matrix) else ():
            rest = beyond(matrix[:, k], basis)
            length = np.linalg.norm(rest)
            if length > threshold:
                picked.append(k)
                basis = np.vstack([basis, rest / length])
    return picked
