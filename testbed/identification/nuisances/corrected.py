"""A source of samples with faults of the instrument taken back, part by part."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.identification.nuisances import clock
from testbed.identification.nuisances.all_nuisances import NUISANCES
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source

Values = Mapping[str, Array]
"""Numbers of nuisances, by kind."""


class Corrected:
    """A recording as another instrument would have made it.

    Samples at the ends that a delay leaves without neighbours are left out.
    """

    def __init__(self, source: Source, values: Values) -> None:
        """The same samples, corrected.

        Args:
            source: As they were measured.
            values: What is to be taken back.
        """
        self._source, self._values = source, values
        self._ends = clock.reach(float(values["skew"][0]), source.rate) if "skew" in values else 0
        self.names, self.rate = source.names, source.rate
        self.samples = source.samples - 2 * self._ends
        self.tare, self.facts, self.signals = source.tare, source.facts, source.signals
        self.senses_kinematics = source.senses_kinematics

    names: tuple[str, ...]
    samples: int
    rate: float
    tare: Array | None
    facts: Mapping[str, Any]
    signals: tuple[str, ...]
    senses_kinematics: bool

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1, without the truth."""
        found = self._source.part(first, last + 2 * self._ends)
        number = np.arange(first, last + 2 * self._ends, dtype=np.float64)
        time = (number - (self._source.samples - 1) / 2) / self.rate
        for nuisance in NUISANCES:
            if nuisance.kind in self._values and nuisance.undo is not None:
                found = nuisance.undo(found, self._values[nuisance.kind], time)
        return found.part(self._ends, self._ends + last - first)
