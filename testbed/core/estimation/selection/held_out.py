"""Laws that may be chosen, and what fits leave of data that they have not seen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.errors import round_significant
from testbed.core.estimation.regression.normal_equations import (
    TINY,
    scaled_solve,
)
from testbed.core.robot.friction import COULOMB, OFFSET, STRIBECK, VISCOUS, stribeck
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.laws.asymmetric import ASYMMETRIC
from testbed.core.robot.laws.quadratic import QUADRATIC
from testbed.core.robot.laws.square_root import SQUARE_ROOT

ALWAYS = (COULOMB, VISCOUS)
"""What every joint has."""

OFFERED = (
    OFFSET,
    ASYMMETRIC,
    QUADRATIC,
    SQUARE_ROOT,
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


SURE = 2.0
"""Standard errors that a gain has to have."""

OWN = 1e-10
"""Part of a column's square beyond all others, below which it is a sum of those."""

Key = TypeVar("Key")


@dataclass(frozen=True, eq=False)
class Parts:
    """Products of columns, the last being the measurement.

    Attributes:
        unseen: Of each part, (parts, m, m).
        seen: Of all rows from which that part is predicted, (parts, m, m).
    """

    unseen: Array
    seen: Array

    def values(self, columns: Sequence[int]) -> Array:
        """What each fit finds of some columns, (parts, k)."""
        own = list(columns)
        return np.array([scaled_solve(s[np.ix_(own, own)], s[own, -1]) for s in self.seen])

    def left(self, columns: Sequence[int]) -> Array:
        """Squares that fits of some columns leave of each part, (parts,)."""
        at = [*columns, self.unseen.shape[1] - 1]
        ends = np.column_stack([-self.values(columns), np.ones(len(self.unseen))])
        inner = self.unseen[:, at][:, :, at]
        return np.asarray(np.maximum(np.einsum("ki,kij,kj->k", ends, inner, ends), 0.0))

    def left_with(self, columns: Sequence[int], more: Sequence[int]) -> Array:
        """The same with one more column, for each of several, (parts, more); inf if it is none."""
        own, new, y = list(columns), list(more), self.unseen.shape[1] - 1
        found = np.empty((len(self.seen), len(new)))
        for k, (seen, unseen) in enumerate(zip(self.seen, self.unseen, strict=True)):
            solved = scaled_solve(seen[np.ix_(own, own)], seen[np.ix_(own, [y, *new])])
            values, held = solved[:, 0], solved[:, 1:]
            beyond = np.diagonal(seen)[new] - np.einsum("ij,ij->j", seen[np.ix_(own, new)], held)
            clear = beyond > OWN * np.diagonal(seen)[new]
            share = np.where(clear, seen[new, y] - seen[np.ix_(new, own)] @ values, 0.0)
            share = share / np.where(clear, beyond, 1.0)
            ends = np.zeros((y + 1, len(new)))  # what is left, in terms of the columns
            ends[own] = share * held - values[:, None]
            ends[new, np.arange(len(new))] -= share
            ends[y] = 1.0
            squares = np.einsum("ij,ij->j", ends, unseen @ ends)
            found[k] = np.where(clear, np.maximum(squares, 0.0), np.inf)
        return found


@dataclass(frozen=True)
class Step:
    """One step of a choice.

    Attributes:
        kind: What was added, or "" for what is always there.
        residual: Rms of what is left of unseen parts, over that of the measurement.
        gain: How many standard errors it is better than without; 0 for the first step.
    """

    kind: str
    residual: float
    gain: float


@dataclass(frozen=True)
class Growth:
    """Columns that were added, one after the other.

    Attributes:
        steps: How, the first being what is always there.
        next_best: What would have come next, and does not gain enough; None for none.
    """

    steps: tuple[Step, ...]
    next_best: Step | None


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
        return float(np.sqrt((self.rows @ self.residual**2) / max(float(self.rows.sum()), 1.0)))


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
    growth: Growth
    before: HeldOut
    after: HeldOut
    parts: int


def grown(
    parts: Parts,
    always: Sequence[int],
    offered: Mapping[Key, int],
    named: Callable[[Key], str],
    rival: Callable[[Key, Key], bool] = lambda one, other: False,
) -> tuple[list[Key], Growth]:
    """Columns chosen by what they gain on data that the fit has not seen.

    Args:
        parts: Products of the parts.
        always: Columns that are there.
        offered: Columns that may be added, by what they are of.
        named: What to call them.
        rival: Whether one is not to be added where the other is.

    Returns:
        What was added, in this order, and how.
    """
    own, open_ones, chosen = list(always), dict(offered), list[Key]()
    whole = max(float(parts.unseen[:, -1, -1].sum()), TINY)
    left = parts.left(own)
    steps = [Step("", float(np.sqrt(left.sum() / whole)), 0.0)]
    while open_ones:
        tried = parts.left_with(own, list(open_ones.values()))
        gains, left_over = _gains(left, tried), tried.sum(axis=0)
        if not np.isfinite(left_over).any():
            break
        sure = gains >= SURE
        k = int(np.argmin(np.where(sure, left_over, np.inf) if sure.any() else left_over))
        best = list(open_ones)[k]
        step = Step(named(best), float(np.sqrt(left_over[k] / whole)), float(gains[k]))
        if not sure.any():
            return chosen, Growth(tuple(steps), step)
        chosen.append(best)
        steps.append(step)
        own.append(open_ones.pop(best))
        open_ones = {key: at for key, at in open_ones.items() if not rival(key, best)}
        left = parts.left(own)
    return chosen, Growth(tuple(steps), None)


def stretches(rows: int, parts: int, reach: int) -> Iterator[tuple[slice, slice]]:
    """Consecutive parts, and each with the rows beside it that share samples with it.

    Args:
        rows: How many there are.
        parts: How many to make.
        reach: Rows beside a part that filters mix with it.
    """
    ends = np.linspace(0, rows, parts + 1).round().astype(int)
    for first, last in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        yield slice(first, last), slice(max(first - reach, 0), min(last + reach, rows))


def _gains(before: Array, after: Array) -> Array:
    """How many standard errors better each of several is, part by part, (more,).

    Shares of what is left: what changes most in one part, as a drift does, is gained in all.
    """
    same = np.where(np.isfinite(after), after, before[:, None])
    gained = np.log(np.maximum(before, TINY)[:, None] / np.maximum(same, TINY))
    error = gained.std(axis=0, ddof=1) / np.sqrt(len(gained))
    return np.asarray(gained.mean(axis=0) / np.maximum(error, TINY))
