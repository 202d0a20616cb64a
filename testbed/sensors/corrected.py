"""Recordings without the sensor errors of known coefficients."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import DerivedSource, Source
from testbed.core.robot.tree import Tree
from testbed.sensors.catalogue import errors_of, estimable_errors
from testbed.sensors.systematic_error import SystematicError


class Corrected(DerivedSource):
    """Recording without sensor errors, joints in the order of the tree.

    Samples at the ends that a delay leaves without neighbours are left out.
    """

    def __init__(
        self, source: Source, values: Mapping[type[SystematicError], Array], tree: Tree
    ) -> None:
        """Samples of a recording, corrected.

        Args:
            source: As they were measured.
            values: Of the coefficients, by sensor error.
            tree: The robot.
        """
        self._source, self._values, self._tree = source, values, tree
        self._ends = sum(e.samples_lost(own, source.rate) for e, own in values.items())
        super().__init__(source, source.samples - 2 * self._ends, source.rate)
        self.names = tree.names
        self.segments = tuple((a, b - 2 * self._ends) for a, b in source.segments)

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1, without the truth."""
        recording = self._source.part(first, last + 2 * self._ends).ordered(self._tree)
        number = np.arange(first, last + 2 * self._ends, dtype=np.float64)
        time = (number - (self._source.samples - 1) / 2) / self.rate
        for error in estimable_errors():
            if error in self._values:
                recording = error.undo(recording, self._values[error], time, self._tree)
        return recording.part(self._ends, self._ends + last - first)


def corrected(source: Source, tree: Tree, coefficients: Mapping[str, float]) -> Source:
    """Recording without the errors of its sensors that another recording has shown.

    Those that are of one recording only, the plate's zero and drift, stay.

    Args:
        source: The recording, of the same sensors.
        tree: The robot.
        coefficients: Values by name, such as "pose/rx"; others are neutral.

    Raises:
        UnknownName: No sensor error has such a coefficient.
    """
    lasting = {
        error: np.array(values)
        for error, values in errors_of(tree, coefficients).items()
        if not error.of_one_recording
    }
    return Corrected(source, lasting, tree) if lasting else source
