"""Families whose coefficients, estimated on some rows, predict others better than none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.restricted_likelihood import Products
from testbed.core.estimation.regression.normal_equations import TINY, scaled_solve

FOLDS = (2, 4, 8)
"""Numbers of consecutive parts, of which each is predicted by the others."""

WEAK = 0.02
"""Part of the information of all rows that holds the unknowns where the seen rows do not."""

BETTER = 0.98
"""Part of the squares left without a family, beyond which its correction is not taken."""


def predictive(products: Products, order: Sequence[str], variances: Array) -> int:
    """How many of the first families in an order predict held-out rows best.

    Args:
        products: Of unknowns and families under white noise.
        order: Kinds, the clearest first.
        variances: Of each kind.
    """
    losses = [_loss(products, order[:k], variances[:k]) for k in range(len(order) + 1)]
    best = int(np.argmin(losses))
    return best if losses[best] < BETTER * losses[0] else 0


def _loss(products: Products, kinds: Sequence[str], variances: Array) -> float:
    """Sum of squares left of held-out rows, in units of the noise."""
    rows, scale = products.rows, products.rows.used / products.noise.total[:, None]
    blocks = [rows.columns, *(rows.families[kind] for kind in kinds)]
    every = np.concatenate([*blocks, rows.measured[..., None]], axis=2)
    every = every * scale[..., None]
    counts = [each.shape[2] for each in blocks]
    known = np.zeros((sum(counts),) * 2)
    known[range(counts[0], sum(counts)), range(counts[0], sum(counts))] = 1 / np.repeat(
        variances, counts[1:]
    )
    flat = every.reshape(-1, every.shape[2])
    whole = flat.T @ flat
    start = scaled_solve(whole[:-1, :-1] + known, whole[:-1, -1])
    known[: counts[0], : counts[0]] += WEAK * whole[: counts[0], : counts[0]]
    offset = np.zeros(len(known))
    offset[: counts[0]] = known[: counts[0], : counts[0]] @ start[: counts[0]]
    total = 0.0
    for folds in FOLDS:
        for part in np.array_split(every, folds, axis=1):
            own = part.reshape(-1, every.shape[2])
            seen = whole - own.T @ own
            values = scaled_solve(seen[:-1, :-1] + known, seen[:-1, -1] + offset)
            left = own[:, -1] - own[:, :-1] @ values
            total += float(left @ left)
    return max(total, TINY)
