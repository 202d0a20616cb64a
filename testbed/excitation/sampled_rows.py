"""Rows of a model at samples of a motion, by the compiled kernel."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from testbed.arrays import Array
from testbed.kernel.layout import Layout, layout
from testbed.kernel.records import Work, sensed
from testbed.parameters.barycentric import barycentric
from testbed.parameters.minimal_set import MinimalSet
from testbed.robot.tree import Tree


class SampledRows:
    """Slots of one model's rows: what each is worth, the layout says.

    The compiled kernel is used whatever the size: a search asks for the same few hundred
    samples thousands of times.
    """

    def __init__(self, tree: Tree, minimal: MinimalSet) -> None:
        """Lay the rows out.

        Args:
            tree: The robot, its inertias an a-priori model.
            minimal: delta_d for rows of the joints, delta_r for those of the bedplate.
        """
        self.minimal = minimal
        self.layout: Layout = layout(tree, minimal)
        self.delta = minimal.values(barycentric(tree))
        self._width = len(self.layout.channels)

    def slots(self, q: Array, qd: Array, qdd: Array) -> Array:
        """All slots, (slots, M), of a motion of M samples, (M, n) each."""
        from testbed.kernel import numba_engine  # a second to import: random motions do not need it

        signals = sensed(q, qd, qdd, self._width)
        if self._room is None:
            self._room = numba_engine.workspace(self.layout, signals)
        made = numba_engine.rows(self.layout, signals, self._room)
        return np.concatenate([block.rows for block in made], axis=1)

    _room: Work | None = None

    def channels(self) -> Iterator[tuple[slice, Array]]:
        """Slots of each channel, and what they have of each minimal parameter, (s, N)."""
        rows = self.layout.rows
        for start, columns in zip(rows.start, self.layout.channels, strict=True):
            yield slice(int(start), int(start) + len(columns)), self.layout.basis[columns]

    @cached_property
    def model(self) -> Array:
        """What slots are worth by the a-priori model, (channels, slots): forces or wrench."""
        found = np.zeros((self._width, self.layout.rows.slots))
        for c, (part, lead) in enumerate(self.channels()):
            found[c, part] = lead @ self.delta
        return found
