"""Products of a recording's rows, part by part: for fits of some, and what they leave of others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import TINY, NormalEquations
from testbed.core.estimation.regression.passes import Columns
from testbed.core.estimation.regression.windows import DENSE
from testbed.core.estimation.selection.folds import CrossProducts, Folds
from testbed.core.kernel.records import Signals
from testbed.core.recordings.source import Source

PARTS = 8
"""Of a recording, one after the other."""

GAP = 0.3
"""Time between a part and the rows that predict it [s]: noise and filters remember."""

FASTER = 1.5
"""Rms speed of the faster half over that of the slower one that makes it another motion."""

ROUNDING = 1e-13
"""Part of a column's square beside its mean that is none but for rounding."""

FREEDOM = 8
"""Rows beyond the unknowns that a channel alone shows, below which its noise is not known."""


@dataclass(frozen=True, eq=False)
class RowProducts:
    """Sums over some rows of products of their columns, of a one and of the measurement.

    Attributes:
        unknowns: Names of the columns, (p,).
        channels: Names, (C,).
        products: Of a row with itself, (C, p + 2, p + 2).
        offset: Whether each channel has a constant of its own that is not known.
    """

    unknowns: tuple[str, ...]
    channels: tuple[str, ...]
    products: Array
    offset: bool

    @property
    def rows(self) -> Array:
        """How many count, (C,)."""
        return self.products[:, -2, -2]

    @property
    def enough(self) -> NDArray[np.bool_]:
        """Whether rows suffice to separate a channel's noise from its unknowns, (C,)."""
        seen = np.einsum("cii->ci", self.products)[:, :-2] > 0
        own = (seen & (seen.sum(axis=0) == 1)).sum(axis=1)
        return np.asarray(self.rows >= own + FREEDOM)

    def equations(self, lead: Array, start: Array) -> NormalEquations:
        """Normal equations of combined columns, for what is left of the measurements.

        Args:
            lead: The columns' combinations, (p, k).
            start: Values of the unknowns whose prediction is taken off, (p,).
        """
        ends = np.zeros((len(start) + 2, lead.shape[1] + 1))
        ends[:-2, :-1], ends[:-2, -1], ends[-1, -1] = lead, -start, 1.0
        inner = ends.T @ self.products @ ends
        if self.offset:
            ones = self.products[:, -2] @ ends
            size = np.einsum("cii->ci", inner)
            inner = (
                inner
                - ones[:, :, None]
                * (ones / np.maximum(self.rows, 1.0)[:, None])[:, None]
            )
            moving = np.einsum("cii->ci", inner) > ROUNDING * size
            inner = np.where(moving[:, :, None] & moving[:, None], inner, 0.0)
        names = tuple(map(str, range(lead.shape[1])))
        normal, right = inner[:, :-1, :-1], inner[:, :-1, -1]
        square = np.maximum(inner[:, -1, -1], 0.0)
        return NormalEquations(names, self.channels, self.rows, normal, right, square)

    def constants(self, values: Array) -> Array:
        """Mean of what values of the unknowns, (p,), leave, (C,); zero where none is unknown."""
        count = np.maximum(self.rows, 1.0)
        mean = (self.products[:, -2, -1] - self.products[:, -2, :-2] @ values) / count
        return mean if self.offset else np.zeros(len(count))

    def squares(self, values: Array, constants: Array) -> Array:
        """Sum of squares that values and constants leave, (C,).

        Args:
            values: Of the unknowns, (p,).
            constants: Of the channels, (C,).
        """
        return np.maximum(_inner(self.products, _ends(values, constants)), 0.0)

    def residual(self, values: Array, constants: Array | None = None) -> Array:
        """Rms residual of unknowns (p,), by channel (C,); constants default to the mean."""
        known = self.constants(values) if constants is None else constants
        return np.sqrt(self.squares(values, known) / np.maximum(self.rows, 1.0))


def _ends(values: Array, constants: Array) -> Array:
    """Residuals as combinations of columns, one and measurement, (C, p + 2)."""
    found = np.ones((len(constants), len(values) + 2))
    found[:, :-2], found[:, -2] = -values, -constants
    return found


def _inner(products: Array, ends: Array) -> Array:
    return np.asarray(np.einsum("ci,cij,cj->c", ends, products, ends))


@dataclass(frozen=True, eq=False)
class RowParts:
    """Gram matrices of the regressor's rows and measurements, by consecutive parts of a recording.

    Attributes:
        problem: Problem whose rows they are.
        cross: Products of each part, and of all rows apart from it.
        offset: Whether each channel has a constant that is not known.
        speed: Mean square of each joint's speed in every part, (parts, n).
    """

    problem: Problem
    cross: CrossProducts
    offset: bool
    speed: Array

    @property
    def each(self) -> list[RowProducts]:
        """Products part by part."""
        return self._of(self.cross.unseen)

    @property
    def whole(self) -> RowProducts:
        """Products of all parts."""
        return sum_of(self.each)

    @cached_property
    def folds(self) -> list[tuple[RowProducts, RowProducts]]:
        """Rows seen and the part to be predicted from them, for each part."""
        return [*zip(self._of(self.cross.seen), self.each, strict=True)]

    def blocks(
        self, length: int
    ) -> Iterator[tuple[RowProducts, list[tuple[int, RowProducts]]]]:
        """Rows seen, and consecutive parts with their numbers to be predicted from them.

        Args:
            length: Parts that are held out together.
        """
        parts = [*enumerate(self.each)]
        for first in range(0, len(parts), length):
            block = parts[first : first + length]
            rest = [part for k, part in parts if not first <= k < first + length]
            yield self.folds[first][0] if length == 1 else sum_of(rest), block

    @property
    def splits(self) -> dict[str, list[tuple[RowProducts, list[RowProducts]]]]:
        """Rows that are seen, and parts to be predicted: by time, and by speed if that differs.

        "like": each part by all others; "faster": the faster half of the parts by the slower one.
        """
        parts = self.each
        splits = {"like": [(seen, [part]) for seen, part in self.folds]}
        size = np.maximum(self.speed.mean(axis=0), TINY)
        pace = (self.speed / size).mean(axis=1)
        slow, fast = np.split(np.argsort(pace, kind="stable"), 2)
        if pace[fast].mean() > FASTER**2 * pace[slow].mean():
            splits["faster"] = [
                (sum_of([parts[k] for k in slow]), [parts[k] for k in fast])
            ]
        return splits

    def _of(self, products: Array) -> list[RowProducts]:
        names, channels = self.problem.names, self.problem.channels
        return [RowProducts(names, channels, each, self.offset) for each in products]


def sum_of(parts: Sequence[RowProducts]) -> RowProducts:
    """Products of several parts of a recording together.

    Args:
        parts: One or more.
    """
    return replace(parts[0], products=np.sum([part.products for part in parts], axis=0))


def products_of(
    problem: Problem,
    source: Source,
    offset: bool,
    whole: bool = False,
    per_cutoff: float = DENSE,
) -> RowParts:
    """Gram matrices of the regressor's rows and measurements, by parts of a recording.

    Args:
        problem: Robot, recording and method.
        source: The recording, faults of the instrument taken back.
        offset: Whether each channel has a constant that is not known.
        whole: As for `Problem.passes`.
        per_cutoff: As for `Problem.passes`.
    """
    width = len(problem.channels)
    passes = problem.passes(1, source, whole, per_cutoff)
    folds = Folds.even(
        passes.plan.rows, PARTS, round(GAP * source.rate / passes.plan.step)
    )
    speed, count = np.zeros((PARTS, problem.tree.n)), np.zeros((PARTS, 1))

    def blocks() -> Iterator[Array]:
        first = 0
        every = np.eye(len(problem.names))
        for columns, moving, measured in passes.rows_beside(
            every, _speeds(source.rate, width)
        ):
            used = columns.any(axis=2, keepdims=True)  # rows near a reversal are zero
            yield np.concatenate([columns, used, measured[..., None]], axis=2)
            for fold, rows in folds.cut(first, moving.shape[1]):
                speed[fold] += (moving[0, rows] ** 2).sum(axis=0)
                count[fold] += len(moving[0, rows])
            first += moving.shape[1]

    cross = folds.products(blocks())
    return RowParts(problem, cross, offset, speed / np.maximum(count, 1))


def _speeds(rate: float, channels: int) -> Columns:
    """Joint speeds at the rows, by central differences, beside every channel."""

    def speeds(signals: Signals, row: int) -> Array:
        at = signals.start + signals.step * np.arange(signals.number)
        q, most = signals.position, len(signals.position) - 1
        ahead, back = (
            np.clip(at + signals.step, 0, most),
            np.clip(at - signals.step, 0, most),
        )
        qd = (q[ahead] - q[back]) * rate / (2 * signals.step)
        return np.broadcast_to(qd, (channels, *qd.shape))

    return speeds
