"""Unknowns of the instrument beside those of the robot: their names, and their columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.identification.nuisances.foretold import RowFilter, foretold
from testbed.identification.nuisances.nuisance import Nuisance, Part
from testbed.identification.windows import Plan
from testbed.kernel.records import Signals
from testbed.robot.tree import Tree

KEPT = 64e6
"""Bytes of columns that are kept from one pass to the next."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Some numbers of some nuisances.

    Attributes:
        nuisances: The kinds.
        parts: All their numbers, kind by kind.
        kept: Places of those among `parts` that are unknown; the others are zero.
    """

    nuisances: tuple[Nuisance, ...]
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

    def by_kind(self, tree: Tree, values: Array) -> dict[str, Array]:
        """Numbers of each nuisance, those that are not unknown zero.

        Args:
            tree: The robot.
            values: Of the unknown ones.
        """
        all_of_them = np.zeros(len(self.parts))
        all_of_them[list(self.kept)] = values
        ends = np.cumsum([len(n.parts(tree)) for n in self.nuisances])
        cut = np.split(all_of_them, ends[:-1])
        return {n.kind: own for n, own in zip(self.nuisances, cut, strict=True)}


def unknowns_of(tree: Tree, nuisances: Sequence[Nuisance]) -> Unknowns:
    """All numbers of some nuisances.

    Args:
        tree: The robot.
        nuisances: The kinds.
    """
    parts = tuple(part for nuisance in nuisances for part in nuisance.parts(tree))
    return Unknowns(tuple(nuisances), parts, tuple(range(len(parts))))


class Columns:
    """Columns of unknowns of the instrument, window by window."""

    def __init__(
        self,
        plan: Plan,
        filtered: RowFilter,
        values: Array,
        unknowns: Sequence[Unknowns],
        estimated: Unknowns | None = None,
    ) -> None:
        """To first order around an estimate.

        Args:
            plan: The rows.
            filtered: The filter that they pass.
            values: Minimal parameters, (p,).
            unknowns: Whose columns, one after the other.
            estimated: Those of them that are to be estimated.
        """
        self._estimated = estimated
        self._plan, self._filtered, self._unknowns = plan, filtered, tuple(unknowns)
        layout = plan.layout
        self._theta = np.asarray(layout.theta @ (layout.basis @ values))
        count = sum(len(each.kept) for each in unknowns)
        self._kept: dict[int, Array] = {}
        self._keeps = plan.rows * 6 * count * 8 < KEPT

    def __call__(self, signals: Signals, first: int) -> Array:
        """Of a window's rows, (6, rows, s).

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
        found = foretold(self._plan, self._filtered, self._theta, signals, first)
        blocks = []
        for unknowns in self._unknowns:
            made = [
                ((unknowns is self._estimated and n.by_measured) or n.columns)(found)
                for n in unknowns.nuisances
            ]
            blocks.append(np.concatenate(made, axis=2)[..., list(unknowns.kept)])
        return np.concatenate(blocks, axis=2).transpose(1, 0, 2)
