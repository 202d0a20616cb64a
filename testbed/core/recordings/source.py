"""Where samples come from: memory, memory maps, files, parts of a stream; and which count."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, Protocol, TypeAlias, runtime_checkable

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.recordings.columns import (
    SIGNALS,
    Segments,
    check_samples,
    check_sampling_time,
    check_values,
    segments_of,
    signal_of,
)
from testbed.core.recordings.metadata import Metadata
from testbed.core.recordings.recording import Recording


def alike(parts: Iterable[Recording]) -> Iterator[Recording]:
    """The parts of one recording, as long as they belong together.

    Raises:
        RecordingError: There are none, or their channels differ.
    """
    layout: tuple[object, ...] = ()
    for part in parts:
        here = (part.names, part.signals, part.truth is None)
        if layout and here != layout:
            raise RecordingError("the parts of the recording have different channels")
        layout = here
        yield part
    if not layout:
        raise RecordingError("the recording has no parts")


class DerivedSource:
    """Header that sources share which are not recordings in memory.

    Attributes:
        names: Joint names.
        samples: Number of samples.
        rate: Samples a second [Hz].
        tare: As `Recording.tare`.
        metadata: As `Recording.metadata`.
        signals: As `Recording.signals`.
        senses_kinematics: Whether velocities and accelerations were sensed, both.
        segments: As `Recording.segments`.
    """

    def __init__(self, header: Source, samples: int, rate: float) -> None:
        """Copy the header of a recording.

        Args:
            header: Any part of the recording, or another form of it.
            samples: Number of samples.
            rate: Samples a second [Hz].
        """
        self.names, self.tare, self.metadata = (
            header.names,
            header.tare,
            header.metadata,
        )
        self.signals, self.senses_kinematics = header.signals, header.senses_kinematics
        self.samples, self.rate = samples, rate
        self.segments: Segments = ((0, samples),)


class StoredRecording(DerivedSource):
    """A recording that stays in its file; parts are read as they are asked for."""

    def __init__(self, path: str | Path) -> None:
        """Open a file; reads its ends only, and all times where there are gaps.

        Raises:
            RecordingError: The file is missing or damaged, a channel is missing, or its times
                are no times of samples.
        """
        from testbed.core.recordings.formats.parquet import open_table

        self._path = Path(path)
        self._table = open_table(self._path)
        self._wanted = [c for c in self._table.columns if signal_of(c) in SIGNALS]
        samples = self._table.samples
        check_samples(samples, str(path))
        start = self.part(0, 1)
        super().__init__(start, samples, 0.0)
        if gaps := self.metadata.gaps:
            time = self._table.read(["time"], 0, samples)["time"]
            self.segments = segments_of(time, gaps)
        steps = self.segments[0][1] - 1
        last = self._table.read(["time"], steps, steps + 1)["time"]
        length = float(last[0] - start.time[0])
        if 0 < length < math.inf:  # else the part says so in which it happens
            check_sampling_time(length / steps, str(path))
            self.rate = steps / length

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1; cheap where parts are asked for in their order.

        Raises:
            RecordingError: The file is damaged there, or a value is no measurement.
        """
        columns = self._table.read(self._wanted, first, last)
        found = Recording.from_columns(columns, self._table.metadata, str(self._path))
        check_values(columns, str(self._path), first)
        return found


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
    def metadata(self) -> Metadata:
        """As `Recording.metadata`."""

    @property
    def signals(self) -> tuple[str, ...]:
        """As `Recording.signals`."""

    @property
    def senses_kinematics(self) -> bool:
        """Whether velocities and accelerations were sensed, both."""

    @property
    def segments(self) -> Segments:
        """As `Recording.segments`."""

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1, without the truth."""


RecordingLike: TypeAlias = Recording | Source | str | Path | Iterable[Recording]
"""A recording in memory, or a Parquet file's path, or parts in the order of time."""


class Stretch(DerivedSource):
    """A stretch of a source, which is a source."""

    def __init__(self, whole: Source, first: int, last: int) -> None:
        """Some of the samples.

        Args:
            whole: Of which.
            first: The first.
            last: The one after the last.
        """
        super().__init__(whole, last - first, whole.rate)
        self._whole, self._first = whole, first
        cut = (np.clip(segment, first, last) - first for segment in whole.segments)
        self.segments = tuple(
            (int(begin), int(end)) for begin, end in cut if end > begin
        )

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1 of the stretch, without the truth."""
        return self._whole.part(self._first + first, self._first + last)


def by_segments(source: Source) -> list[Source]:
    """The segments of a source, each a source; itself where it has no gap.

    Args:
        source: The recording.
    """
    if len(source.segments) == 1:
        return [source]
    return [Stretch(source, first, last) for first, last in source.segments]


def longest_segment(source: Source) -> tuple[int, int]:
    """First sample of the longest segment, and the one after its last.

    Args:
        source: The recording.
    """
    return max(source.segments, key=np.ptp)


def open_source(what: RecordingLike) -> Source:
    """Samples from memory, from a file that stays where it is, or from parts in turn.

    Args:
        what: A recording, the path of one, or parts of one in the order of time.

    Raises:
        RecordingError: The file is no recording, or the parts do not belong together.
    """
    if isinstance(what, str | Path):
        return StoredRecording(what)
    # asked as a Source, it is asked for its rate
    if isinstance(what, Recording | Source):
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
        mapped: dict[str, Any] = {
            name: _mapped(file, part, name) for name, file in files.items()
        }
    return replace(part, truth=None, **mapped)


def _mapped(file: IO[bytes], like: Recording, name: str) -> Array:
    file.flush()
    shape = (-1, *getattr(like, name).shape[1:])
    if not file.tell():  # nothing can be mapped: not a sample in all parts
        return np.zeros((0, *shape[1:]))
    found: Array = np.memmap(file, dtype=np.float64, mode="r").reshape(shape)
    return found


def counted(source: Source, span: Sequence[float] | None = None) -> Source:
    """The samples of a recording that count.

    Args:
        source: One recording.
        span: From the first to before the second time [s]; default what the recording says, as one
            from rest to rest does, else all.

    Raises:
        RecordingError: None of its samples is in that time.
    """
    span = span or source.metadata.counted
    if span is None or source.samples < 2:
        return source
    begin = float(source.part(0, 1).time[0])
    first, last = (
        int(np.clip(np.ceil((time - begin) * source.rate - 1e-6), 0, source.samples))
        for time in span
    )
    if first == last:
        end = begin + (source.samples - 1) / source.rate
        raise RecordingError(
            f"the recording goes from {begin:g} to {end:g} s: it has nothing from {span[0]:g} to "
            f"{span[1]:g} s, which is to be counted (identification.span)"
        )
    return source if last - first == source.samples else Stretch(source, first, last)
