"""Unknowns of the instrument beside those of the robot: their names, and their columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.identification.regression.windows import Plan
from testbed.identification.sensor.nuisance import Nuisance, Part
from testbed.identification.sensor.predicted_wrench import (
    PredictedWrench,
    RowFilter,
    predict_wrench,
)
from testbed.kernel.records import Signals
from testbed.robot.tree import Tree

KEPT = 64e6
"""Bytes of columns that are kept from one pass to the next."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Some numbers of some nuisances.

    Attributes:
        nuisances: The kinds.
        counts: How many numbers each has.
        parts: All their numbers, kind by kind.
        kept: Places of those among `parts` that are unknown; the others are as they should be.
    """

    nuisances: tuple[Nuisance, ...]
    counts: tuple[int, ...]
    parts: tuple[Part, ...]
    kept: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of those that are unknown."""
        return tuple(self.parts[k].name for k in self.kept)

    @property
    def units(self) -> tuple[str, ...]:
        """One each."""
        return tuple(self.parts[k].unit for k in self.kept)

    @property
    def right(self) -> Array:
        """Values of the unknown ones where nothing is wrong."""
        return np.array([self.parts[k].right for k in self.kept])

    @property
    def kinds(self) -> tuple[str, ...]:
        """Whose number each unknown one is."""
        all_of_them = np.repeat([n.kind for n in self.nuisances], self.counts)
        return tuple(str(all_of_them[k]) for k in self.kept)

    def unmixed(self, values: Array) -> Array | None:
        """What takes a mixture of the plate's channels back, (6, 6); None where there is none.

        Args:
            values: Of the unknown ones.
        """
        numbers = self.by_kind(values)
        for nuisance in self.nuisances:
            if nuisance.unmixed is not None:
                return nuisance.unmixed(numbers[nuisance.kind])
        return None

    def by_kind(self, values: Array) -> dict[str, Array]:
        """Numbers of each nuisance, those that are not unknown as they should be.

        Args:
            values: Of the unknown ones.
        """
        all_of_them = np.array([part.right for part in self.parts])
        all_of_them[list(self.kept)] = values
        cut = np.split(all_of_them, np.cumsum(self.counts, dtype=int))[:-1]
        return {n.kind: own for n, own in zip(self.nuisances, cut, strict=True)}


def unknowns_of(tree: Tree, nuisances: Sequence[Nuisance]) -> Unknowns:
    """All numbers of some nuisances.

    Args:
        tree: The robot.
        nuisances: The kinds.
    """
    each = [nuisance.parts(tree) for nuisance in nuisances]
    parts = tuple(part for own in each for part in own)
    counts = tuple(len(own) for own in each)
    return Unknowns(tuple(nuisances), counts, parts, tuple(range(len(parts))))


class Columns:
    """Columns of unknowns of the instrument, window by window."""

    def __init__(
        self,
        plan: Plan,
        filtered: RowFilter,
        values: Array,
        unknowns: Sequence[Unknowns],
        estimated: Unknowns | None = None,
        unmixed: Array | None = None,
        always: int | None = None,
    ) -> None:
        """To first order around an estimate.

        Args:
            plan: The rows.
            filtered: The filter that they pass.
            values: Minimal parameters, (p,).
            unknowns: Whose columns, one after the other.
            estimated: Those of them that are to be estimated.
            unmixed: What a mixture of the plate's channels was taken back with, (6, 6).
            always: How many of `unknowns` have columns in all windows; default all. The others
                have them in those that are looked at.
        """
        self._always, self._looked_at = always, plan.looked_at
        self._unmixed = unmixed
        self._estimated = estimated
        self._plan, self._filtered, self._unknowns = plan, filtered, tuple(unknowns)
        layout = plan.layout
        self._theta = np.asarray(layout.theta @ (layout.basis @ values))
        part = len(self._looked_at) / len(list(plan.windows()))
        counts = [len(each.kept) for each in unknowns]
        numbers = sum(counts[:always]) + part * sum(counts[len(counts[:always]) :])
        self._kept: dict[int, Array] = {}
        self._keeps = plan.rows * 6 * numbers * 8 < KEPT

    def __call__(self, signals: Signals, first: int) -> Array:
        """Of a window's rows, (6, rows, s); fewer where it is not looked at.

        Args:
            signals: The window's.
            first: Number of its first row.
        """
        if first in self._kept:
            return self._kept[first]
        made = self._made(signals, first)
        if self._keeps:
            self._kept[first] = made
        return made

    def _made(self, signals: Signals, first: int) -> Array:
        shown = self._unknowns[: None if first in self._looked_at else self._always]
        if not shown:
            return np.zeros((6, signals.number, 0))
        found = predict_wrench(self._plan, self._filtered, self._theta, signals, first)
        blocks = []
        for unknowns in shown:
            own = unknowns is self._estimated
            made = [self._shown(n, found, own) for n in unknowns.nuisances]
            blocks.append(np.concatenate(made, axis=2)[..., list(unknowns.kept)])
        return np.concatenate(blocks, axis=2).transpose(1, 0, 2)

    def _shown(self, nuisance: Nuisance, found: PredictedWrench, estimated: bool) -> Array:
        """What a nuisance does to the wrench, mixtures of the channels taken back."""
        made = ((estimated and nuisance.by_measured) or nuisance.columns)(found)
        if not nuisance.added or self._unmixed is None:
            return made
        return np.asarray(self._unmixed @ made)
