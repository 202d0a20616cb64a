"""Recordings corrected by what is known of the instrument, and what the calibration leaves open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from testbed.core.base.arrays import Array, freeze
from testbed.core.estimation.regression.constraints import LinearConstraints
from testbed.core.estimation.sensor.clocks import CLOCKS, reach
from testbed.core.estimation.sensor.encoders import ENCODERS
from testbed.core.estimation.sensor.estimates import Nuisance
from testbed.core.estimation.sensor.plate import PLATE
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import DerivedSource, Source
from testbed.core.robot.tree import Tree

NUISANCES = tuple(n for n in (*CLOCKS, *PLATE, *ENCODERS) if n.undo is not None)
"""Those that can be estimated, in the order in which they are taken back: last made, first."""

TESTED = tuple(n for n in (*CLOCKS, *PLATE, *ENCODERS) if n.tested)
"""Those whose traces are looked for in every estimate."""


@dataclass(frozen=True, eq=False)
class CalibrationCovariance:
    """Doubt about numbers of the plate that were taken back from a recording.

    Attributes:
        names: Of the numbers, (k,).
        root: R with R R' their covariance, (k, r).
    """

    names: tuple[str, ...]
    root: Array

    def __post_init__(self) -> None:
        shape = (len(self.names), np.shape(self.root)[-1])
        freeze(self, root=shape)

    def nuisances(self, tree: Tree, asked: Sequence[Nuisance]) -> list[Nuisance]:
        """Kinds whose numbers it is about, but for those that are estimated anyway.

        Args:
            tree: The robot.
            asked: Those that are estimated.
        """
        named = set(self.names)
        return [
            n
            for n in NUISANCES
            if n not in asked and not n.passing and named & {p.name for p in n.parts(tree)}
        ]

    def added(
        self, given: LinearConstraints, right: dict[str, float], unknowns: Sequence[str]
    ) -> LinearConstraints:
        """Facts with those about the plate: numbers are as they should be, but for the doubt.

        Args:
            given: Facts about the unknowns.
            right: Values of the plate's numbers where nothing is wrong, by name.
            unknowns: Names of all unknowns, in the order of the facts' columns.
        """
        rows = np.zeros((len(right), len(unknowns)))
        rows[range(len(right)), [list(unknowns).index(name) for name in right]] = 1.0
        root = np.zeros((len(right), self.root.shape[1]))
        for row, name in zip(root, right, strict=True):
            if name in self.names:
                row[:] = self.root[self.names.index(name)]
        return replace(
            given,
            names=(*given.names, *right),
            rows=np.vstack([given.rows, rows]),
            values=np.append(given.values, list(right.values())),
            root=block_diag(given.root, root),
            scale=np.vstack([given.scale, np.zeros_like(rows)]),
            reached=np.append(given.reached, np.zeros(len(right))),
        )


class Corrected(DerivedSource):
    """A recording as another instrument would have made it, joints in the order of the tree.

    Samples at the ends that a delay leaves without neighbours are left out.
    """

    def __init__(self, source: Source, values: Mapping[str, Array], tree: Tree) -> None:
        """The same samples, corrected.

        Args:
            source: As they were measured.
            values: What is to be taken back, by kind of nuisance.
            tree: The robot.
        """
        self._source, self._values, self._tree = source, values, tree
        self._ends = reach(float(values["skew"][0]), source.rate) if "skew" in values else 0
        super().__init__(source, source.samples - 2 * self._ends, source.rate)
        self.names = tree.names
        self.segments = tuple((a, b - 2 * self._ends) for a, b in source.segments)

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1, without the truth."""
        found = self._source.part(first, last + 2 * self._ends).ordered(self._tree)
        number = np.arange(first, last + 2 * self._ends, dtype=np.float64)
        time = (number - (self._source.samples - 1) / 2) / self.rate
        for nuisance in NUISANCES:
            if nuisance.kind in self._values and nuisance.undo is not None:
                found = nuisance.undo(found, self._values[nuisance.kind], time, self._tree)
        return found.part(self._ends, self._ends + last - first)
