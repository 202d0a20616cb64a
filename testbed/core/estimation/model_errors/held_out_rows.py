"""Cross-validation of model errors: families that improve the prediction of held-out rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.restricted_likelihood import ProjectedRows
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    solve_scaled,
)

FOLDS = (2, 4, 8)
"""Numbers of folds; each fold is a consecutive part that the others predict."""

WEAK_PRIOR_SHARE = 0.02
"""Part of the information of all rows that serves as prior of the unknowns."""

MAX_LOSS_RATIO = 0.98
"""Largest ratio of squared prediction errors with and without families for a correction."""


def predictive_count(
    products: ProjectedRows, order: Sequence[str], variances: Array
) -> int:
    """Number of leading families that predict held-out rows best; 0 without improvement.

    The best number has the smallest loss (`_held_out_loss`), below MAX_LOSS_RATIO times the loss
    without families.

    Args:
        products: Unknowns and families under white noise.
        order: Kinds of families, in order of decreasing gain.
        variances: Variance of each family's coefficients.
    """
    losses = [
        _held_out_loss(products, order[:k], variances[:k])
        for k in range(len(order) + 1)
    ]
    best = int(np.argmin(losses))
    return best if losses[best] < MAX_LOSS_RATIO * losses[0] else 0


def _held_out_loss(
    products: ProjectedRows, kinds: Sequence[str], variances: Array
) -> float:
    """Sum of squared prediction errors of held-out rows, in units of the noise.

    Rows are divided into 2, 4 and 8 consecutive parts (FOLDS). The rows of a part are predicted
    from all others and the prior of `_weak_prior`; errors of the three divisions are summed.

    Args:
        products: Unknowns and families under white noise.
        kinds: Kinds of families in the model.
        variances: Variance of each family's coefficients.
    """
    rows, scale = products.rows, products.rows.row_mask / products.noise.total[:, None]
    blocks = [rows.columns, *(rows.families[kind] for kind in kinds)]
    rows_with_measured = np.concatenate([*blocks, rows.measured[..., None]], axis=2)
    rows_with_measured = rows_with_measured * scale[..., None]
    whole = _gram_matrix(rows_with_measured)
    counts = [each.shape[2] for each in blocks]
    prior, offset = _weak_prior(whole, counts, variances)
    total = 0.0
    for folds in FOLDS:
        for part in np.array_split(rows_with_measured, folds, axis=1):
            test_rows = part.reshape(-1, rows_with_measured.shape[2])
            training = whole - test_rows.T @ test_rows
            values = solve_scaled(
                training[:-1, :-1] + prior, training[:-1, -1] + offset
            )
            errors = test_rows[:, -1] - test_rows[:, :-1] @ values
            total += float(errors @ errors)
    return max(total, SMALLEST_POSITIVE)


def _gram_matrix(rows: Array) -> Array:
    """Products of columns, (q, q), summed over channels and rows (C, R, q)."""
    flat = rows.reshape(-1, rows.shape[2])
    return flat.T @ flat


def _weak_prior(
    whole: Array, counts: Sequence[int], variances: Array
) -> tuple[Array, Array]:
    """Prior information matrix, (q, q), and information times mean, (q,).

    The q variables are p unknowns, then coefficients of families. The prior of the unknowns is
    centred on the solution from all rows and has WEAK_PRIOR_SHARE of its information. The prior of
    the coefficients has mean zero and the given variances.

    Args:
        whole: Products of all rows' columns and measurements, (q + 1, q + 1).
        counts: Number of columns of the unknowns, then of each family.
        variances: Variance of each family's coefficients.
    """
    p = counts[0]
    prior = np.diag(np.concatenate([np.zeros(p), 1 / np.repeat(variances, counts[1:])]))
    mean = solve_scaled(whole[:-1, :-1] + prior, whole[:-1, -1])[:p]
    offset = np.zeros(len(prior))
    offset[:p] = WEAK_PRIOR_SHARE * whole[:p, :p] @ mean
    prior[:p, :p] += WEAK_PRIOR_SHARE * whole[:p, :p]
    return prior, offset
