"""Recordings larger than memory: read part by part from their file, or written so."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path

from testbed.arrays import Array
from testbed.recordings.checks import check_sampling_time
from testbed.recordings.columns import SIGNALS, joints_in, signal_of
from testbed.recordings.formats import open_table
from testbed.recordings.formats.parquet import write_table
from testbed.recordings.parts import alike
from testbed.recordings.recording import Recording


class StoredRecording:
    """A recording that stays in its file; parts are read as they are asked for.

    Attributes:
        names: Joint names.
        samples: Number of samples.
        rate: Samples a second [Hz].
        tare: As `Recording.tare`.
        facts: As `Recording.facts`.
        signals: As `Recording.signals`.
        senses_kinematics: Whether velocities and accelerations were sensed, both.
    """

    def __init__(self, path: str | Path) -> None:
        """Open a file; reads its ends only.

        Raises:
            RecordingError: The file is missing or damaged, a channel is missing, or its times
                are no times of samples.
        """
        self._path = Path(path)
        self._table = open_table(self._path)
        self._wanted = [c for c in self._table.columns if signal_of(c) in SIGNALS]
        self.names = joints_in(self._wanted)
        self.samples = self._table.samples
        start = self.part(0, min(1, self.samples))
        self.tare, self.facts = start.tare, start.facts
        self.signals, self.senses_kinematics = start.signals, start.senses_kinematics
        self.rate = 0.0
        if self.samples > 1:
            last = self._table.read(["time"], self.samples - 1, self.samples)["time"]
            length = float(last[0] - start.time[0])
            if 0 < length < math.inf:  # else the part says so in which it happens
                check_sampling_time(length / (self.samples - 1), str(path))
                self.rate = (self.samples - 1) / length

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1; cheap where parts are asked for in their order.

        Raises:
            RecordingError: The file is damaged there.
        """
        columns = self._table.read(self._wanted, first, last)
        return Recording.from_columns(columns, self._table.metadata, str(self._path))


def write_parts(parts: Iterable[Recording], path: Path) -> None:
    """Write parts of one recording to a Parquet file, in the order of time, one at a time.

    Raises:
        RecordingError: There are none, or their channels differ.
    """
    whole = iter(alike(parts))
    first = next(whole)

    def columns() -> Iterator[dict[str, Array]]:
        yield first.columns() | first.true_columns()
        for part in whole:
            yield part.columns() | part.true_columns()

    write_table(path, first.units(), first.metadata, columns())
