"""Forward selection of laws by cross-validation, and its evidence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.errors import round_significant
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.estimation.selection.folds import CrossValidation
from testbed.core.robot.friction import (
    COULOMB,
    FURTHER,
    OFFSET,
    STRIBECK,
    VISCOUS,
    stribeck,
)
from testbed.core.robot.joint_law import JointLaw

ALWAYS = (COULOMB, VISCOUS)
"""What every joint has."""

OFFERED = (
    OFFSET,
    *FURTHER,
    # friction that fades out between these speeds [rad/s or m/s]
    *(stribeck(round_significant(speed, 2)) for speed in np.geomspace(0.02, 1.0, 14)),
)
"""What may be added."""


def rivals(one: JointLaw, other: JointLaw) -> bool:
    """Whether two laws are not to be chosen both: friction that fades out at two speeds.

    Args:
        one: A law.
        other: Another.
    """
    return all(law.kind.startswith(STRIBECK) for law in (one, other))


Z_GAIN = 2.0
"""Standard errors that a gain has to have."""

LEAST_GAIN = 0.02
"""Part of what is left by which a gain lowers it at least."""

Key = TypeVar("Key")


@dataclass(frozen=True)
class SelectionStep:
    """One step of a forward selection.

    Attributes:
        kind: What was added, or "" for what is always there.
        residual: Rms of what is left of unseen parts, over that of the measurement.
        gain: How many standard errors it is better than without; 0 for the first step.
    """

    kind: str
    residual: float
    gain: float


@dataclass(frozen=True)
class ForwardSelection:
    """Columns that were added, one after the other.

    Attributes:
        steps: How, the first being what is always there.
        next_best: What would have come next, and does not gain enough; None for none.
    """

    steps: tuple[SelectionStep, ...]
    next_best: SelectionStep | None


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What fits of all other parts leave of each part of a recording.

    Attributes:
        channels: The joints.
        units: N m or N, one each.
        signal: Rms of the torques, (n,) [N m or N].
        residual: Rms of what is left of unseen parts, (n,) [N m or N].
        rows: How many count, (n,).
    """

    channels: tuple[str, ...]
    units: tuple[str, ...]
    signal: Array
    residual: Array
    rows: Array

    def __post_init__(self) -> None:
        n = len(self.channels)
        freeze(self, signal=(n,), residual=(n,), rows=(n,))

    @property
    def rms(self) -> float:
        """Of all joints' rows together [N m], or [N] where all slide."""
        return float(
            np.sqrt((self.rows @ self.residual**2) / max(float(self.rows.sum()), 1.0))
        )


@dataclass(frozen=True, eq=False)
class TermChoice:
    """The terms of the torques, and the evidence.

    Attributes:
        words: Such as "coulomb/elbow", as `Settings.terms` takes them.
        growth: How they were found; the first step is what all joints and shafts have.
        before: What is left with that alone.
        after: What is left with all of them.
        parts: Into how many the recording was cut.
    """

    words: tuple[str, ...]
    growth: ForwardSelection
    before: HeldOut
    after: HeldOut
    parts: int


def forward_selection(
    folds: CrossValidation,
    always: Sequence[int],
    offered: Mapping[Key, int],
    named: Callable[[Key], str],
    rival: Callable[[Key, Key], bool] = lambda one, other: False,
) -> tuple[list[Key], ForwardSelection]:
    """Columns chosen by their gain on unseen folds.

    Args:
        folds: Products of the folds.
        always: Columns that are there.
        offered: Columns that may be added, by what they are of.
        named: What to call them.
        rival: Whether one is not to be added where the other is.

    Returns:
        What was added, in this order, and how.
    """
    own, candidates, chosen = list(always), dict(offered), list[Key]()
    whole = max(float(folds.unseen[:, -1, -1].sum()), TINY)

    def step(name: str, squares: Array, gain: float = 0.0) -> SelectionStep:
        return SelectionStep(name, float(np.sqrt(squares.sum() / whole)), gain)

    squares = folds.residual_squares(own)
    steps = [step("", squares)]
    while candidates:
        each = folds.with_each(own, list(candidates.values()))
        gains, total = _gains(squares, each), each.sum(axis=0)
        if not np.isfinite(total).any():
            break
        clear = (gains >= Z_GAIN) & (total < (1 - LEAST_GAIN) ** 2 * squares.sum())
        k = int(np.argmin(np.where(clear, total, np.inf) if clear.any() else total))
        best = list(candidates)[k]
        following = step(named(best), each[:, k], float(gains[k]))
        if not clear.any():
            return chosen, ForwardSelection(tuple(steps), following)
        chosen.append(best)
        steps.append(following)
        own.append(candidates.pop(best))
        candidates = {key: at for key, at in candidates.items() if not rival(key, best)}
        squares = folds.residual_squares(own)
    return chosen, ForwardSelection(tuple(steps), None)


def _gains(before: Array, after: Array) -> Array:
    """How many standard errors better each of several is, fold by fold, (more,).

    By logarithms: what changes most in one fold, as a drift does, is gained in all.
    """
    same = np.where(np.isfinite(after), after, before[:, None])
    gained = np.log(np.maximum(before, TINY)[:, None] / np.maximum(same, TINY))
    error = gained.std(axis=0, ddof=1) / np.sqrt(len(gained))
    return np.asarray(gained.mean(axis=0) / np.maximum(error, TINY))
