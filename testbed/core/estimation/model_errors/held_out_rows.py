"""Families whose coefficients, estimated on some rows, predict others better than none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.restricted_likelihood import ProjectedRows
from testbed.core.estimation.regression.normal_equations import TINY, scaled_solve

FOLDS = (2, 4, 8)
"""Numbers of consecutive parts, of which each is predicted by the others."""

WEAK = 0.02
"""Part of the information of all rows that holds the unknowns where the seen rows do not."""

BETTER = 0.98
"""Part of the squares left without a family, beyond which its correction is not taken."""


def predictive(products: ProjectedRows, order: Sequence[str], variances: Array) -> int:
    """How many of the first families in an order predict held-out rows best.

    Args:
        products: Of unknowns and families under white noise.
        order: Kinds, the clearest first.
        variances: Of each kind.
    """
    losses = [_loss(products, order[:k], variances[:k]) for k in range(len(order) + 1)]
    best = int(np.argmin(losses))
    return best if losses[best] < BETTER * losses[0] else 0


def _loss(products: ProjectedRows, kinds: Sequence[str], variances: Array) -> float:
    """Sum of squares left of held-out rows, in units of the noise."""
    rows, scale = products.rows, products.rows.used / products.noise.total[:, None]
    blocks = [rows.columns, *(rows.families[kind] for kind in kinds)]
    every = np.concatenate([*blocks, rows.measured[..., None]], axis=2)
    every = every * scale[..., None]
    whole = _squares(every)
    counts = [each.shape[2] for each in blocks]
    known, offset = _weak_prior(whole, counts, variances)
    total = 0.0
    for folds in FOLDS:
        for part in np.array_split(every, folds, axis=1):
            own = part.reshape(-1, every.shape[2])
            seen = whole - own.T @ own
            values = scaled_solve(seen[:-1, :-1] + known, seen[:-1, -1] + offset)
            left = own[:, -1] - own[:, :-1] @ values
            total += float(left @ left)
    return max(total, TINY)


def _squares(rows: Array) -> Array:
    """Products of columns, (q, q), of rows (C, R, q)."""
    flat = rows.reshape(-1, rows.shape[2])
    return flat.T @ flat


def _weak_prior(
    whole: Array, counts: Sequence[int], variances: Array
) -> tuple[Array, Array]:
    """Information before the seen rows, (p, p), and information times mean, (p,).

    Args:
        whole: Products of all rows' columns and measurements, (p + 1, p + 1).
        counts: Columns of the unknowns, and of each family.
        variances: Of each family.
    """
    p = counts[0]
    known = np.diag(np.concatenate([np.zeros(p), 1 / np.repeat(variances, counts[1:])]))
    start = scaled_solve(whole[:-1, :-1] + known, whole[:-1, -1])[:p]
    offset = np.zeros(len(known))
    offset[:p] = WEAK * whole[:p, :p] @ start
    known[:p, :p] += WEAK * whole[:p, :p]
    return known, offset
