"""Conversion of a mapping file's sources into recordings on a uniform grid."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from collections.abc import Mapping as Table
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import (
    MAX_LIST_WIDTH,
    RecordingError,
    UnknownName,
    count_with_noun,
    shortened_list,
)
from testbed.core.recordings.columns import check_columns
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.repeats import new_sample_mask, repeated_sample_share
from testbed.core.recordings.source import gather_parts
from testbed.importing.derivative import check_derivatives
from testbed.importing.encoder_steps import unwrapped_positions
from testbed.importing.foreign_table import MAX_NUMBERS, ForeignTable
from testbed.importing.import_report import ImportReport, SignalReport
from testbed.importing.mapping import AnyTable, BaseTable, Mapping, read_mapping
from testbed.importing.readers import open_foreign_table
from testbed.importing.recording_columns import (
    recording_metadata,
    signal_columns,
    used_columns,
)
from testbed.importing.resampling import (
    MIN_SIGNAL_SAMPLES,
    TIME_TOLERANCE,
    filter_half_length,
    resample_to_grid,
    spline_to_common_rows,
)
from testbed.importing.signal_maps import (
    check_stated_units,
    continuous_quaternions,
    torques_with_sign,
)
from testbed.importing.source_clock import (
    ClockReport,
    SourceTimes,
    Window,
    clock_report,
    distinct_sample_mask,
    equidistant_times,
    longest_interpolated_gap,
    sample_times,
    slice_within_gaps,
    times_from_common_origin,
    windows_between_gaps,
)
from testbed.importing.stated_errors import remove_stated_errors


@dataclass(frozen=True, eq=False)
class _Stream:
    """Complete samples of a signal at the rate of its source.

    Attributes:
        table: Table of the signal in the mapping.
        file: Table of the foreign file that holds the samples.
        time: Sample times, (M,) [s].
        values: Values in the units of the file, (M, k).
        rows: Row indices of the samples in the file, (M,).
        begin: Time of the first sample of the source [s].
        shorter: Difference between the duration of the source's longest signal and the duration of
            this signal [s].
    """

    table: AnyTable
    file: ForeignTable
    time: Array
    values: Array
    rows: NDArray[np.intp]
    begin: float
    shorter: float = 0.0


@dataclass(frozen=True, eq=False)
class _Samples:
    """Samples of a signal in a window: times [s], values (M, k), rate [Hz], and reports."""

    time: Array
    values: Array
    rate: float
    clock: ClockReport
    report: SignalReport


def import_recordings(
    path: Path, mapping: Mapping | None = None
) -> tuple[tuple[Recording, ...], list[Diagnostic]]:
    """Recordings of a mapping file, separated at gaps, and diagnostics of the gaps.

    Times are measured from the first sample of the first recording. The import report is in
    `metadata.report`, and its diagnostics are in `metadata.diagnostics`.

    Args:
        path: Mapping file, TOML; its file names are relative to it.
        mapping: Content of the mapping file; default: read from `path`.

    Raises:
        ExperimentError: The mapping is not valid.
        RecordingError: A file is missing or damaged, or lacks columns of the mapping.
    """
    mapping = mapping or read_mapping(path)
    try:
        streams = _streams(mapping, path.parent)
        clocks = [
            (
                each.table.source,
                mapping.sources[each.table.source],
                each.time,
                each.rows,
            )
            for each in streams.values()
        ]
        windows, cuts = windows_between_gaps(_common_window(mapping, streams), clocks)
        sampled = [_samples_and_grid(mapping, streams, window) for window in windows]
        origin, recordings = float(sampled[0][1][0]), []
        for samples, grid in sampled:
            columns, metadata = _recording_columns(
                mapping, streams, samples, grid, origin
            )
            recording = Recording.from_columns(columns, metadata, str(path))
            recording = remove_stated_errors(mapping, recording)
            check_columns(recording.columns(), str(path), recording.segments)
            recordings.append(recording)
    except (RecordingError, UnknownName) as error:
        error.args = (_message_with_files(path, mapping, str(error)),)
        raise
    return tuple(recordings), cuts


def import_recording(path: str | Path) -> Recording:
    """Import a mapping file as one recording (docs/your-recording.md), joined across gaps.

    Args:
        path: Mapping file, TOML; its file names are relative to it.

    Raises:
        ExperimentError: The mapping is not valid.
        RecordingError: A file is missing or damaged, or lacks columns of the mapping.
    """
    return joined_recording(*import_recordings(Path(path)))


def joined_recording(
    recordings: Sequence[Recording], cuts: Sequence[Diagnostic]
) -> Recording:
    """Join recordings of a mapping file, with metadata of the longest and all diagnostics.

    Args:
        recordings: Recordings in chronological order.
        cuts: Diagnostics of the gaps between the recordings; empty for one recording.
    """
    if not cuts:
        return recordings[0]
    longest = max(recordings, key=lambda each: each.samples)
    diagnostics = (d for each in recordings for d in each.metadata.diagnostics)
    metadata = replace(
        longest.metadata,
        gaps=tuple(float(each.time[0]) for each in recordings[1:]),
        diagnostics=(*cuts, *dict.fromkeys(diagnostics)),
    )
    return replace(gather_parts(recordings), metadata=metadata)


def _message_with_files(path: Path, mapping: Mapping, message: str) -> str:
    """Error message with the names of the mapping file and of a data file."""
    message = message.removeprefix(f"{path}: ")
    files = [source.file for source in mapping.sources.values()]
    own = [
        each.file
        for name, each in mapping.sources.items()
        if f"sources.{name}:" in message
    ]
    if any(file in message for file in files):
        return f"{path}: {message}"
    return f"{path}: {shortened_list(own or files, MAX_LIST_WIDTH)}: {message}"


def source_time_ranges(
    mapping: Mapping, folder: Path
) -> dict[str, tuple[float, float]]:
    """First and last time of each source from a common origin (offset and skew corrected) [s].

    Args:
        mapping: Content of the mapping file.
        folder: Folder of the mapping file.

    Raises:
        RecordingError: A file is missing or damaged, or its times are not valid.
    """
    return {
        each.table.source: (float(each.time.min()), float(each.time.max()))
        for each in _streams(mapping, folder).values()
    }


def _samples_and_grid(
    mapping: Mapping, streams: Table[str, _Stream], window: Window
) -> tuple[dict[str, _Samples], Array]:
    """Samples of all signals in a window, and the grid times in the window [s]."""
    samples = {
        label: _samples(mapping, label, each, window) for label, each in streams.items()
    }
    return samples, _grid_times(mapping, samples.values(), window)


def _recording_columns(
    mapping: Mapping,
    streams: Table[str, _Stream],
    samples: Table[str, _Samples],
    grid: Array,
    origin: float,
) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns and metadata of a recording on a grid.

    Grid times are (L,) [s], and `origin` becomes time zero; the dictionaries of streams and samples
    are keyed by label in the mapping.
    """
    columns: dict[str, Array] = {"time": grid - origin}
    clocks: dict[str, ClockReport] = {}
    for label, stream in streams.items():
        check_stated_units(label, stream.table, stream.file)
        signal, name = samples[label], stream.table.source
        terms = signal_columns(
            mapping,
            label,
            resample_to_grid(signal.time, signal.values, signal.rate, grid),
        )
        # wrenches of several plates are summed
        columns |= {name: terms[name] + columns.get(name, 0.0) for name in terms}
        clock = replace(
            signal.clock, lead=origin - stream.begin, cut=stream.file.is_incomplete
        )
        if clocks.setdefault(name, clock) != clock:  # other missing samples
            clocks[f"{name}, {label}"] = clock
    reports = {label: signal.report for label, signal in samples.items()}
    reports |= check_derivatives(mapping, columns, reports)
    report = ImportReport(mapping.rate, len(grid), clocks, reports)
    return columns, recording_metadata(mapping, report)


def _open_source(folder: Path, mapping: Mapping, name: str) -> ForeignTable:
    """Open the file of a source; RecordingError if the columns in use differ in length."""
    source = mapping.sources[name]
    path = folder / source.file
    if not folder.is_dir():  # folder of an unwritten mapping
        path = Path(os.path.normpath(path))
    table = open_foreign_table(path, source.topic)
    lengths = table.lengths
    needed = [*used_columns(mapping)[name], *([source.time] if source.time else [])]
    counts = {column: lengths[column] for column in needed if column in lengths}
    if len(set(counts.values())) > 1:
        pairs = ", ".join(
            f"'{column}' {count}" for column, count in list(counts.items())[:4]
        )
        raise RecordingError(
            f"sources.{name}: columns of different lengths: {pairs}; say a source for each length, "
            "with the times of as many samples"
        )
    return table


def _source_times(mapping: Mapping, name: str, table: ForeignTable) -> SourceTimes:
    """Sample times of a source, corrected by its `skew` but not by its `offset`.

    Without a time column, samples are equidistant at the rate of the source or, by default, of the
    recording.

    Raises:
        RecordingError: All time stamps are equal.
    """
    source = mapping.sources[name]
    if source.time is None:
        column = table.time_stamps(used_columns(mapping)[name][0])
        time = SourceTimes(0.0, np.arange(len(column)) / (source.rate or mapping.rate))
    else:
        time = sample_times(
            name, source, table.time_stamps(source.time), table.unit(source.time)
        )
    since = time.time_after_start
    if np.nanmin(since) == np.nanmax(since):
        raise RecordingError(
            f"sources.{name}: '{source.time}' is the same at all samples; say another column, or "
            "`rate` instead of `time`"
        )
    return replace(
        time, time_after_start=since[0] + (since - since[0]) * (1 + source.skew)
    )


def _streams(mapping: Mapping, folder: Path) -> dict[str, _Stream]:
    """Complete samples of all signals, keyed by label of the signal's table in the mapping."""
    files = {
        name: _open_source(folder, mapping, name) for name in used_columns(mapping)
    }
    clocks = {name: _source_times(mapping, name, file) for name, file in files.items()}
    times = times_from_common_origin(
        clocks, {name: mapping.sources[name].offset for name in clocks}
    )
    streams = {
        label: _stream(label, table, files[table.source], times[table.source])
        for label, table in mapping.all_signal_tables.items()
    }
    spans = sorted(
        (each.table.source, float(np.ptp(each.time))) for each in streams.values()
    )
    longest = dict(spans)
    return {
        label: replace(
            each, shorter=longest[each.table.source] - float(np.ptp(each.time))
        )
        for label, each in streams.items()
    }


def _stream(label: str, table: AnyTable, file: ForeignTable, time: Array) -> _Stream:
    """Samples of a signal with finite time and finite values in all columns.

    Columns that share no row with finite values are interpolated (`spline_to_common_rows`).

    Raises:
        RecordingError: There are fewer than `MIN_SIGNAL_SAMPLES` samples.
    """
    values = file.matrix(table.columns)
    finite = np.isfinite(values)
    rows = np.flatnonzero(finite.all(axis=1) & np.isfinite(time))
    if not len(rows) and finite.any(axis=0).all():
        rows, values = spline_to_common_rows(time, values)
    if len(rows) < MIN_SIGNAL_SAMPLES:
        reason = f"{count_with_noun(len(rows), 'sample')} of [{label}], which is no recording"
        for name in (
            n
            for n, valid in zip(table.columns, finite.T, strict=True)
            if not valid.any()
        ):
            reason = f"'{name}' holds no number; leave [{label}] out"
        raise RecordingError(f"sources.{table.source}: {reason}")
    begin = float(time[np.isfinite(time)][0])
    return _Stream(table, file, time[rows], values[rows], rows, begin)


def _common_window(mapping: Mapping, streams: Table[str, _Stream]) -> Window:
    """First and last time common to signals and requested interval [s]; RecordingError if none."""
    first = max(float(each.time.min()) for each in streams.values())
    last = min(float(each.time.max()) for each in streams.values())
    times = {each.table.source: each.time for each in streams.values()}
    if first >= last:
        ranges = "; ".join(
            f"{n} {t.min():.9g} to {t.max():.9g} s" for n, t in times.items()
        )
        reference, *others = times
        offsets = ", ".join(
            f"[sources.{n}] offset = "
            f"{mapping.sources[n].offset + times[reference].min() - times[n].min():.6g}"
            for n in others
        )
        raise RecordingError(
            f"the sources have no time in common: {ranges}; their clocks differ: {offsets} would "
            "make them begin together; say what is true to some hundredths of a second, "
            "--align finds the rest"
        )
    last = min(last, first + (mapping.stop or np.inf))
    first += mapping.start
    if first >= last:
        raise RecordingError(
            f"start = {mapping.start:g} s leaves nothing of the recording"
        )
    return first, last


def _samples(mapping: Mapping, label: str, stream: _Stream, window: Window) -> _Samples:
    """Samples in a window and one sample beyond either end, without repeated samples.

    The signal's delay is subtracted from the times. Values remain in the units of the file: torques
    are signed according to their sign bit, positions are unwrapped, and quaternions are made
    continuous.
    """
    table, time, name = stream.table, stream.time, stream.table.source
    source = mapping.sources[name]
    low, high = np.searchsorted(np.maximum.accumulate(time), window)
    nearby = slice(max(0, low - 1), min(high + 2, len(time)))
    part = slice_within_gaps(source, time, stream.rows, nearby, window)
    if part.stop <= part.start:
        raise RecordingError(
            f"sources.{name}: time does not increase; say `rate` instead of `time`"
        )
    stamps, values, rows = time[part], stream.values[part], stream.rows[part]
    distinct = distinct_sample_mask(name, stamps, values, steady=source.steady)
    stamps, values = stamps[distinct], values[distinct]
    times = equidistant_times(name, stamps, rows[distinct]) if source.steady else stamps
    clock = clock_report(name, source, stamps, times, int(np.count_nonzero(~distinct)))
    time, rate, share, dropped = (
        times - table.delay,
        clock.rate,
        repeated_sample_share(values),
        0,
    )
    if source.drop_held:
        measured = new_sample_mask(values)
        dropped = int(np.count_nonzero(~measured))
        time, values = time[measured], values[measured]
        rate = float(1 / np.median(np.diff(time)))
    if isinstance(table, BaseTable):
        values = np.hstack([values[:, :3], continuous_quaternions(values[:, 3:])])
    values = torques_with_sign(table, values) if table is mapping.torque else values
    findings: list[Diagnostic] = []
    if stream.shorter > longest_interpolated_gap(source, 1 / rate):
        findings.append(
            make_diagnostic("import.shorter", label, stream.shorter, source=name)
        )
    if table is mapping.position:
        names = mapping.joints if table.matrix is None else table.columns
        values, steps = unwrapped_positions(table, names, time, values)
        findings += steps
    low_passed = filter_half_length(rate, mapping.rate) > 0
    report = SignalReport(name, share, dropped, low_passed, tuple(findings))
    return _Samples(time, values, rate, clock, report)


def _grid_times(
    mapping: Mapping, samples: Iterable[_Samples], window: tuple[float, float]
) -> Array:
    """Times of the uniform grid, (L,) [s], without the ends that low-pass filters remove.

    Raises:
        RecordingError: The grid has too many samples for memory, or fewer than two.
    """
    first, last = window
    for each in samples:
        ends = filter_half_length(each.rate, mapping.rate)
        first, last = (max(first, each.time[0] + ends), min(last, each.time[-1] - ends))
    columns = 1 + 6 * len(mapping.joints)
    count = (last - first) * mapping.rate
    if not count * columns <= MAX_NUMBERS:
        raise RecordingError(
            f"rate = {mapping.rate:g} Hz makes {count:.2g} samples, too many for memory"
        )
    if count < 2:
        raise RecordingError(
            f"{max(0.0, last - first):.3g} s are left of what the sources have in common, too "
            f"little for {mapping.rate:g} Hz; is `time_unit` right, and every source's `offset`?"
        )
    return (
        first + np.arange(int(count + TIME_TOLERANCE * mapping.rate) + 1) / mapping.rate
    )
