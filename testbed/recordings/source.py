"""Where samples come from: memory, memory maps, files, or a stream of parts."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, Protocol, runtime_checkable

import numpy as np

from testbed.arrays import Array
from testbed.recordings.columns import SIGNALS
from testbed.recordings.parts import alike
from testbed.recordings.recording import Recording


@runtime_checkable
class Source(Protocol):
    """Samples that can be had part by part: a `Recording`, or one that stays in its file."""

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names."""

    @property
    def samples(self) -> int:
        """Number of samples."""

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""

    @property
    def tare(self) -> Array | None:
        """As `Recording.tare`."""

    @property
    def facts(self) -> Mapping[str, Any]:
        """As `Recording.facts`."""

    @property
    def signals(self) -> tuple[str, ...]:
        """As `Recording.signals`."""

    @property
    def senses_kinematics(self) -> bool:
        """Whether velocities and accelerations were sensed, both."""

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1, without the truth."""


RecordingLike = Recording | Source | str | Path | Iterable[Recording]
"""A recording in memory, or a Parquet file's path, or parts in the order of time."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of a source, which is a source.

    Attributes:
        whole: Of which.
        first: Its first sample.
        last: The one after its last.
    """

    whole: Source
    first: int
    last: int

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names."""
        return self.whole.names

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.last - self.first

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""
        return self.whole.rate

    @property
    def tare(self) -> Array | None:
        """As `Recording.tare`."""
        return self.whole.tare

    @property
    def facts(self) -> Mapping[str, Any]:
        """As `Recording.facts`."""
        return self.whole.facts

    @property
    def signals(self) -> tuple[str, ...]:
        """As `Recording.signals`."""
        return self.whole.signals

    @property
    def senses_kinematics(self) -> bool:
        """Whether velocities and accelerations were sensed, both."""
        return self.whole.senses_kinematics

    @property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """As `segments_of`."""
        cut = [np.clip(s, self.first, self.last) - self.first for s in segments_of(self.whole)]
        return tuple((int(first), int(last)) for first, last in cut if last > first)

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1 of the stretch, without the truth."""
        return self.whole.part(self.first + first, self.first + last)


def segments_of(source: Source) -> tuple[tuple[int, int], ...]:
    """Stretches without a gap: the first sample of each, and the one after its last.

    Args:
        source: One stretch, unless it says otherwise.
    """
    found: tuple[tuple[int, int], ...] = getattr(source, "segments", ((0, source.samples),))
    return found


def open_source(what: RecordingLike) -> Source:
    """Samples from memory, from a file that stays where it is, or from parts in turn.

    Args:
        what: A recording, the path of one, or parts of one in the order of time.

    Raises:
        RecordingError: The file is no recording, or the parts do not belong together.
    """
    if isinstance(what, str | Path):
        from testbed.recordings.stored import StoredRecording

        return StoredRecording(what)
    if isinstance(what, Recording | Source):  # asked as a Source, it is asked for its rate
        return what
    return gathered(what)


def gathered(parts: Iterable[Recording]) -> Recording:
    """One recording of parts that need not fit into memory together.

    It is kept in unnamed temporary files, which go when it goes.

    Args:
        parts: In the order of time, of one robot.

    Raises:
        RecordingError: There are none, or they do not belong together.
    """
    with ExitStack() as open_files:
        files: dict[str, IO[bytes]] = {}
        for part in alike(parts):
            for name in SIGNALS:
                values = getattr(part, name)
                if values is None:
                    continue
                if name not in files:
                    files[name] = open_files.enter_context(tempfile.TemporaryFile())
                files[name].write(np.ascontiguousarray(values).tobytes())
        mapped: dict[str, Any] = {name: _mapped(file, part, name) for name, file in files.items()}
    return replace(part, truth=None, **mapped)


def _mapped(file: IO[bytes], like: Recording, name: str) -> Array:
    file.flush()
    shape = (-1, *getattr(like, name).shape[1:])
    if not file.tell():  # nothing can be mapped: not a sample in all parts
        return np.zeros((0, *shape[1:]))
    found: Array = np.memmap(file, dtype=np.float64, mode="r").reshape(shape)
    return found
