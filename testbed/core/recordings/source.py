"""Sources of samples (memory, memory maps, files, streams), and selection of samples."""

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
    RECORDED_SIGNALS,
    Segments,
    check_samples,
    check_sampling_time,
    check_values,
    segments_of,
    signal_of,
)
from testbed.core.recordings.metadata import Metadata
from testbed.core.recordings.recording import Recording


def check_parts(parts: Iterable[Recording]) -> Iterator[Recording]:
    """Yield the parts of a recording, checking that all have the same channels.

    Raises:
        RecordingError: There are no parts, or their channels differ.
    """
    layout: tuple[object, ...] = ()
    for part in parts:
        part_layout = (part.names, part.signals, part.truth is None)
        if layout and part_layout != layout:
            raise RecordingError("the parts of the recording have different channels")
        layout = part_layout
        yield part
    if not layout:
        raise RecordingError("the recording has no parts")


class DerivedSource:
    """Base class of sources other than recordings in memory, with the recording's header.

    Attributes:
        names: Joint names.
        samples: Number of samples.
        rate: Sampling rate [Hz].
        tare: Tare, as in `Recording.tare`.
        metadata: Metadata, as in `Recording.metadata`.
        signals: Signals, as in `Recording.signals`.
        senses_kinematics: True if both velocities and accelerations were sensed.
        segments: Segments, as in `Recording.segments`.
    """

    def __init__(self, header: Source, samples: int, rate: float) -> None:
        """Copy the header of a recording.

        Args:
            header: Any part of the recording, or another source of it.
            samples: Number of samples.
            rate: Sampling rate [Hz].
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
    """Recording in a Parquet file, read part by part on demand."""

    def __init__(self, path: str | Path) -> None:
        """Open a file; read its first and last samples, and all times if there are gaps.

        Raises:
            RecordingError: The file is missing or damaged, a channel is missing, or the sampling
                time is invalid.
        """
        from testbed.core.recordings.formats.parquet import open_table

        self._path = Path(path)
        self._table = open_table(self._path)
        self._columns = [
            c for c in self._table.columns if signal_of(c) in RECORDED_SIGNALS
        ]
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
        if 0 < length < math.inf:  # else reading the part raises an error
            check_sampling_time(length / steps, str(path))
            self.rate = steps / length

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last - 1` of the file; fastest for consecutive parts.

        Raises:
            RecordingError: These rows of the file are damaged, or a value is not valid.
        """
        columns = self._table.read(self._columns, first, last)
        recording = Recording.from_columns(
            columns, self._table.metadata, str(self._path)
        )
        check_values(columns, str(self._path), first)
        return recording


@runtime_checkable
class Source(Protocol):
    """Protocol of sources of samples that are read part by part, such as a `Recording`."""

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names."""

    @property
    def samples(self) -> int:
        """Number of samples."""

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""

    @property
    def tare(self) -> Array | None:
        """Tare, as in `Recording.tare`."""

    @property
    def metadata(self) -> Metadata:
        """Metadata, as in `Recording.metadata`."""

    @property
    def signals(self) -> tuple[str, ...]:
        """Signals, as in `Recording.signals`."""

    @property
    def senses_kinematics(self) -> bool:
        """True if both velocities and accelerations were sensed."""

    @property
    def segments(self) -> Segments:
        """Segments, as in `Recording.segments`."""

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last - 1`, without the true signals."""


RecordingLike: TypeAlias = Recording | Source | str | Path | Iterable[Recording]
"""Recording in memory, path of a Parquet file, or parts of a recording in order of time."""


class SourceRange(DerivedSource):
    """Range of consecutive samples of a source."""

    def __init__(self, whole: Source, first: int, last: int) -> None:
        """Select samples `first` to `last - 1` of a source.

        Args:
            whole: Source of the samples.
            first: Index of the first sample.
            last: Index after the last sample.
        """
        super().__init__(whole, last - first, whole.rate)
        self._whole, self._first = whole, first
        cut = (np.clip(segment, first, last) - first for segment in whole.segments)
        self.segments = tuple(
            (int(begin), int(end)) for begin, end in cut if end > begin
        )

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last - 1` of this range, without the true signals."""
        return self._whole.part(self._first + first, self._first + last)


def segment_sources(source: Source) -> list[Source]:
    """Segments of a recording between its gaps, as a list of sources.

    Args:
        source: The recording; if it has no gaps, it is the only element of the list.
    """
    if len(source.segments) == 1:
        return [source]
    return [SourceRange(source, first, last) for first, last in source.segments]


def longest_segment(source: Source) -> tuple[int, int]:
    """Index of the longest segment's first sample, and index after its last sample.

    Args:
        source: The recording.
    """
    return max(source.segments, key=np.ptp)


def open_source(recording: RecordingLike) -> Source:
    """Open a source of samples: a recording in memory, a file, or parts.

    A file is read on demand; parts are gathered in temporary files.

    Args:
        recording: Recording, path of a recording, or parts of a recording in order of time.

    Raises:
        RecordingError: The file is no recording, or the parts have different channels.
    """
    if isinstance(recording, str | Path):
        return StoredRecording(recording)
    # isinstance with the protocol Source evaluates `rate`: test for Recording first
    if isinstance(recording, Recording | Source):
        return recording
    return gather_parts(recording)


def gather_parts(parts: Iterable[Recording]) -> Recording:
    """Gather parts into one recording, memory-mapped from unnamed temporary files.

    The parts need not fit into memory together. The files are deleted when the recording is.

    Args:
        parts: Parts of a recording in order of time.

    Raises:
        RecordingError: There are no parts, or their channels differ.
    """
    with ExitStack() as open_files:
        files: dict[str, IO[bytes]] = {}
        for part in check_parts(parts):
            for name in RECORDED_SIGNALS:
                values = getattr(part, name)
                if values is None:
                    continue
                if name not in files:
                    files[name] = open_files.enter_context(tempfile.TemporaryFile())
                files[name].write(np.ascontiguousarray(values).tobytes())
        signals: dict[str, Any] = {
            name: _memory_map(file, part, name) for name, file in files.items()
        }
    return replace(part, truth=None, **signals)


def _memory_map(file: IO[bytes], recording: Recording, name: str) -> Array:
    """Memory map of a file of float64 values, with the columns of a recording's signal."""
    file.flush()
    shape = (-1, *getattr(recording, name).shape[1:])
    if not file.tell():  # nothing can be mapped: not a sample in all parts
        return np.zeros((0, *shape[1:]))
    values: Array = np.memmap(file, dtype=np.float64, mode="r").reshape(shape)
    return values


def evaluated_samples(source: Source, span: Sequence[float] | None = None) -> Source:
    """Samples of a recording within the time span that is evaluated.

    Args:
        source: A single recording.
        span: Time of the first sample and time after the last sample [s]; by default the span in
            the metadata (such as the motion between two rest periods) or, without it, all samples.

    Raises:
        RecordingError: The span contains no samples.
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
    return (
        source if last - first == source.samples else SourceRange(source, first, last)
    )
