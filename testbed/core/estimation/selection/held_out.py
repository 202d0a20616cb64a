"""Forward selection of joint laws by cross-validation, and the evidence for the choice."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.errors import round_significant
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE
from testbed.core.estimation.selection.folds import CrossValidation
from testbed.core.robot.friction import (
    ADDITIONAL_LAWS,
    COULOMB,
    OFFSET,
    STRIBECK_KIND,
    VISCOUS,
    stribeck_law,
)
from testbed.core.robot.joint_law import JointLaw

BASE_LAWS = (COULOMB, VISCOUS)
"""Laws of every joint."""

CANDIDATE_LAWS = (
    OFFSET,
    *ADDITIONAL_LAWS,
    # friction that fades out between these speeds [rad/s or m/s]
    *(
        stribeck_law(round_significant(speed, 2))
        for speed in np.geomspace(0.02, 1.0, 14)
    ),
)
"""Candidate laws of the forward selection."""


def are_exclusive(first: JointLaw, second: JointLaw) -> bool:
    """True if both laws are Stribeck friction, so that only one may be selected.

    Args:
        first: Law.
        second: Another law.
    """
    return all(law.kind.startswith(STRIBECK_KIND) for law in (first, second))


MIN_Z_GAIN = 2.0
"""Smallest significant gain, in standard errors."""

MIN_RELATIVE_GAIN = 0.02
"""Smallest relative reduction of the rms test residual."""

Key = TypeVar("Key")


@dataclass(frozen=True)
class SelectionStep:
    """Step of a forward selection: added column and test residual.

    Attributes:
        kind: Name of the added column; "" for the base columns.
        residual: Rms test residual relative to the rms measurement.
        gain: Reduction of the residual in standard errors; 0 for the first step.
    """

    kind: str
    residual: float
    gain: float


@dataclass(frozen=True)
class ForwardSelection:
    """Sequence of columns added by a forward selection.

    Attributes:
        steps: Steps of the selection, the base columns first.
        next_best: Step with the best remaining candidate, whose gain is insufficient; None if no
            candidates remain.
    """

    steps: tuple[SelectionStep, ...]
    next_best: SelectionStep | None


@dataclass(frozen=True, eq=False)
class TestResiduals:
    """Test residuals of a cross-validation, channel by channel.

    Attributes:
        channels: Names of the channels, (n,).
        units: Unit of each channel, N m or N.
        signal: Rms of the measurements, (n,) [N m or N].
        residual: Rms of the test residuals, (n,) [N m or N].
        rows: Number of rows used in each channel, (n,).
    """

    channels: tuple[str, ...]
    units: tuple[str, ...]
    signal: Array
    residual: Array
    rows: Array

    def __post_init__(self) -> None:
        n = len(self.channels)
        freeze_arrays(self, signal=(n,), residual=(n,), rows=(n,))

    @property
    def rms(self) -> float:
        """Rms of the test residuals of all channels [N m], or [N] for prismatic joints."""
        return float(
            np.sqrt((self.rows @ self.residual**2) / max(float(self.rows.sum()), 1.0))
        )


@dataclass(frozen=True, eq=False)
class TermChoice:
    """Joint laws chosen by cross-validation, with the evidence for the choice.

    Attributes:
        words: Chosen terms such as "coulomb/elbow", as in `Settings.terms`.
        growth: Steps of the forward selection, which starts with the default laws.
        before: Test residuals with the default laws (`usual_terms`) only.
        after: Test residuals with all chosen laws.
        parts: Number of folds.
    """

    words: tuple[str, ...]
    growth: ForwardSelection
    before: TestResiduals
    after: TestResiduals
    parts: int


def forward_selection(
    folds: CrossValidation,
    base_columns: Sequence[int],
    offered: Mapping[Key, int],
    name_of: Callable[[Key], str],
    exclusive: Callable[[Key, Key], bool] = lambda one, other: False,
) -> tuple[list[Key], ForwardSelection]:
    """Select columns one by one, by the significance of their gain in cross-validation.

    A gain is significant if it is at least 2 standard errors (MIN_Z_GAIN) and reduces the rms test
    residual by 2 % (MIN_RELATIVE_GAIN). Of the significant candidates, the one with the smallest
    residual is added.

    Args:
        folds: Products of the folds.
        base_columns: Indices of the base columns.
        offered: Indices of the candidate columns, keyed by candidate.
        name_of: Function that returns the name of a candidate.
        exclusive: Function that returns True if two candidates must not be selected together.

    Returns:
        Selected candidates in order, and the steps of the selection.
    """
    columns, candidates, chosen = list(base_columns), dict(offered), list[Key]()
    measured_square = max(float(folds.test[:, -1, -1].sum()), SMALLEST_POSITIVE)

    def selection_step(name: str, squares: Array, gain: float = 0.0) -> SelectionStep:
        return SelectionStep(
            name, float(np.sqrt(squares.sum() / measured_square)), gain
        )

    squares = folds.residual_squares(columns)
    steps = [selection_step("", squares)]
    while candidates:
        squares_with_candidates = folds.squares_with_candidates(
            columns, list(candidates.values())
        )
        z_scores, total = (
            _gain_z_scores(squares, squares_with_candidates),
            squares_with_candidates.sum(axis=0),
        )
        if not np.isfinite(total).any():
            break
        significant = (z_scores >= MIN_Z_GAIN) & (
            total < (1 - MIN_RELATIVE_GAIN) ** 2 * squares.sum()
        )
        k = int(
            np.argmin(
                np.where(significant, total, np.inf) if significant.any() else total
            )
        )
        best = list(candidates)[k]
        next_step = selection_step(
            name_of(best), squares_with_candidates[:, k], float(z_scores[k])
        )
        if not significant.any():
            return chosen, ForwardSelection(tuple(steps), next_step)
        chosen.append(best)
        steps.append(next_step)
        columns.append(candidates.pop(best))
        candidates = {
            key: column
            for key, column in candidates.items()
            if not exclusive(key, best)
        }
        squares = folds.residual_squares(columns)
    return chosen, ForwardSelection(tuple(steps), None)


def _gain_z_scores(before: Array, after: Array) -> Array:
    """Mean log reduction of the squares over the folds, in standard errors, (candidates,).

    Logarithms give all folds the same weight, even if a drift dominates the squares of one fold.

    Args:
        before: Squared residuals of each fold, (folds,).
        after: Squared residuals with each candidate, (folds, candidates).
    """
    finite_squares = np.where(np.isfinite(after), after, before[:, None])
    log_ratios = np.log(
        np.maximum(before, SMALLEST_POSITIVE)[:, None]
        / np.maximum(finite_squares, SMALLEST_POSITIVE)
    )
    standard_error = log_ratios.std(axis=0, ddof=1) / np.sqrt(len(log_ratios))
    return np.asarray(
        log_ratios.mean(axis=0) / np.maximum(standard_error, SMALLEST_POSITIVE)
    )
