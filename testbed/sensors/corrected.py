"""Correction of recordings for sensor errors with known coefficients."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import DerivedSource, Source
from testbed.core.robot.tree import Tree
from testbed.sensors.catalogue import coefficients_by_error, estimable_errors
from testbed.sensors.systematic_error import SystematicError


class CorrectedSource(DerivedSource):
    """Recording corrected for sensor errors, with joints in the order of the tree.

    The errors are corrected one after the other, beginning at the end of the measuring chain.
    Samples at both ends that lack neighbours for the correction of a delay are left out.
    """

    def __init__(
        self, source: Source, values: Mapping[type[SystematicError], Array], tree: Tree
    ) -> None:
        """Set up the correction of a recording.

        Args:
            source: The measured recording.
            values: Coefficients of the sensor errors, keyed by class.
            tree: The robot.
        """
        self._source, self._values, self._tree = source, values, tree
        self._lost_samples = sum(
            error.lost_sample_count(coefficients, source.rate)
            for error, coefficients in values.items()
        )
        super().__init__(source, source.samples - 2 * self._lost_samples, source.rate)
        self.names = tree.names
        self.segments = tuple(
            (a, b - 2 * self._lost_samples) for a, b in source.segments
        )

    def part(self, first: int, last: int) -> Recording:
        """Corrected samples `first` to `last - 1`, without true signals."""
        recording = self._source.part(first, last + 2 * self._lost_samples).ordered(
            self._tree
        )
        number = np.arange(first, last + 2 * self._lost_samples, dtype=np.float64)
        time = (number - (self._source.samples - 1) / 2) / self.rate
        for error in estimable_errors():
            if error in self._values:
                recording = error.corrected_recording(
                    recording, self._values[error], time, self._tree
                )
        return recording.part(self._lost_samples, self._lost_samples + last - first)


def corrected(source: Source, tree: Tree, coefficients: Mapping[str, float]) -> Source:
    """Recording corrected for sensor errors estimated from another recording.

    Errors that differ between recordings (zero and drift of the plate) are not corrected. If there
    are no other errors, the recording is returned unchanged.

    Args:
        source: The recording, made with the same sensors.
        tree: The robot.
        coefficients: Values keyed by name, such as "pose/rx"; other coefficients are neutral.

    Raises:
        UnknownName: No sensor error has such a coefficient.
    """
    persistent = {
        error: np.array(values)
        for error, values in coefficients_by_error(tree, coefficients).items()
        if not error.of_one_recording
    }
    return CorrectedSource(source, persistent, tree) if persistent else source
