"""From a mapping file to recordings on a uniform grid."""

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
from testbed.core.base.codec import encode
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import WIDTH, RecordingError, UnknownName, few, plural
from testbed.core.recordings.columns import check_columns, members_of
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.repeats import held_share, slow_device
from testbed.core.recordings.source import gathered
from testbed.importing.derivative import derivatives
from testbed.importing.encoder_steps import without_turns
from testbed.importing.foreign_table import MOST_NUMBERS, ForeignTable
from testbed.importing.import_report import ImportReport, SignalReport
from testbed.importing.mapping import (
    AnyTable,
    BaseTable,
    ForceSensorTable,
    Mapping,
    SixAxisTable,
    WrenchTable,
    read_mapping,
)
from testbed.importing.readers import open_foreign
from testbed.importing.resampling import (
    FEWEST,
    SAME,
    low_pass_reach,
    on_common_rows,
    onto_grid,
)
from testbed.importing.signal_maps import (
    base_pose,
    check_units,
    effort_kinds,
    joint_kinds,
    joint_signal,
    signed,
    without_turnovers,
    wrench_of,
)
from testbed.importing.source_clock import (
    ClockReport,
    Times,
    Window,
    by_one_clock,
    clock_report,
    cut,
    longest_bridged,
    sample_times,
    steady_times,
    without_gaps,
    without_repeats,
)
from testbed.importing.stated_errors import without_stated_errors


@dataclass(frozen=True, eq=False)
class _Stream:
    """Samples of a signal at its source's rate, without incomplete ones.

    Attributes:
        table: What the mapping says of the signal.
        file: Where they are.
        time: (M,) [s].
        values: (M, k).
        rows: Their places in the file, (M,).
        begin: Instant of the source's first sample [s].
        shorter: How much less of the time they cover than other signals of the source [s].
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
    """A signal's columns, (M, k), and when and how they were sampled."""

    time: Array
    values: Array
    rate: float
    clock: ClockReport
    report: SignalReport


def pieces(
    path: Path, mapping: Mapping | None = None
) -> tuple[tuple[Recording, ...], list[Diagnostic]]:
    """Recordings that a mapping file makes, in the order of time, and where it was cut.

    Times are since the first recording's first sample. What was found on the way is in
    `metadata.report`, what to doubt in `metadata.diagnostics`.

    Args:
        path: The mapping file, TOML; the files it names are relative to it.
        mapping: What it says; default what is in it.

    Raises:
        ExperimentError: The mapping is not understood.
        RecordingError: A file is missing or damaged, or does not hold what the mapping says.
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
        windows, cuts = cut(_window(mapping, streams), clocks)
        sampled = [_on_grid(mapping, streams, window) for window in windows]
        origin, recordings = float(sampled[0][1][0]), []
        for samples, grid in sampled:
            columns, metadata = _converted(mapping, streams, samples, grid, origin)
            recording = Recording.from_columns(columns, metadata, str(path))
            recording = without_stated_errors(mapping, recording)
            check_columns(recording.columns(), str(path), recording.segments)
            recordings.append(recording)
    except (RecordingError, UnknownName) as error:
        error.args = (_with_files(path, mapping, str(error)),)
        raise
    return tuple(recordings), cuts


def import_recording(path: str | Path) -> Recording:
    """Recording that a mapping file makes (docs/your-recording.md).

    Args:
        path: The mapping file, TOML; the files it names are relative to it.

    Raises:
        ExperimentError: The mapping is not understood.
        RecordingError: As `pieces`.
    """
    return concatenated(*pieces(Path(path)))


def concatenated(
    recordings: Sequence[Recording], cuts: Sequence[Diagnostic]
) -> Recording:
    """One recording of all that a mapping file makes; metadata are the longest's.

    Args:
        recordings: As of `pieces`.
        cuts: Between them.
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
    return replace(gathered(recordings), metadata=metadata)


def _with_files(path: Path, mapping: Mapping, said: str) -> str:
    """What is wrong with data, with the names of the mapping file and of a data file."""
    said = said.removeprefix(f"{path}: ")
    files = [source.file for source in mapping.sources.values()]
    own = [
        each.file
        for name, each in mapping.sources.items()
        if f"sources.{name}:" in said
    ]
    if any(file in said for file in files):
        return f"{path}: {said}"
    return f"{path}: {few(own or files, WIDTH)}: {said}"


def clock_ranges(mapping: Mapping, folder: Path) -> dict[str, tuple[float, float]]:
    """First and last instant of each source by its own clock, since an instant in common [s].

    Args:
        mapping: What the files' columns mean.
        folder: To which the files are relative.

    Raises:
        RecordingError: A file is missing or damaged, or its clock is none.
    """
    return {
        each.table.source: (float(each.time.min()), float(each.time.max()))
        for each in _streams(mapping, folder).values()
    }


def _on_grid(
    mapping: Mapping, streams: Table[str, _Stream], window: Window
) -> tuple[dict[str, _Samples], Array]:
    """Samples of all signals in a window, and the recording's instants there [s]."""
    samples = {
        label: _samples(mapping, label, each, window) for label, each in streams.items()
    }
    return samples, _grid(mapping, samples.values(), window)


def _converted(
    mapping: Mapping,
    streams: Table[str, _Stream],
    samples: Table[str, _Samples],
    grid: Array,
    origin: float,
) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns and metadata of a recording at instants, times since an origin."""
    columns: dict[str, Array] = {"time": grid - origin}
    clocks: dict[str, ClockReport] = {}
    for label, each in streams.items():
        check_units(label, each.table, each.file)
        got, name = samples[label], each.table.source
        made = _mapped(mapping, label, onto_grid(got.time, got.values, got.rate, grid))
        # plates add up
        columns |= {name: made[name] + columns.get(name, 0.0) for name in made}
        clock = replace(got.clock, lead=origin - each.begin, cut=each.file.cut)
        if clocks.setdefault(name, clock) != clock:  # other samples are missing
            clocks[f"{name}, {label}"] = clock
    reports = {label: got.report for label, got in samples.items()}
    reports |= derivatives(mapping, columns, reports)
    report = ImportReport(mapping.rate, len(grid), clocks, reports)
    return columns, _metadata(mapping, report)


def _used(mapping: Mapping) -> dict[str, list[str]]:
    """Columns that are needed, by source."""
    found: dict[str, list[str]] = {}
    for table in mapping.tables.values():
        found.setdefault(table.source, []).extend(table.columns)
    unused = [name for name in mapping.sources if name not in found]
    if unused:
        raise RecordingError(f"sources.{unused[0]}: no signal is of it")
    return found


def _open(folder: Path, mapping: Mapping, name: str) -> ForeignTable:
    """A source's file, and whether its columns are of one length."""
    source = mapping.sources[name]
    path = folder / source.file
    if not folder.is_dir():  # of a mapping that is not written yet
        path = Path(os.path.normpath(path))
    table = open_foreign(path, source.topic)
    lengths = table.lengths
    wanted = [*_used(mapping)[name], *([source.time] if source.time else [])]
    counts = {column: lengths[column] for column in wanted if column in lengths}
    if len(set(counts.values())) > 1:
        said = ", ".join(
            f"'{column}' {count}" for column, count in list(counts.items())[:4]
        )
        raise RecordingError(
            f"sources.{name}: columns of different lengths: {said}; say a source for each length, "
            "with the times of as many samples"
        )
    return table


def _times(mapping: Mapping, name: str, table: ForeignTable) -> Times:
    """Sample times of a source, corrected for clock drift [s]; nan where not recorded."""
    source = mapping.sources[name]
    if source.time is None:
        column = table.stamps(_used(mapping)[name][0])
        time = Times(0.0, np.arange(len(column)) / (source.rate or mapping.rate))
    else:
        time = sample_times(
            name, source, table.stamps(source.time), table.unit(source.time)
        )
    since = time.since
    if np.nanmin(since) == np.nanmax(since):
        raise RecordingError(
            f"sources.{name}: '{source.time}' is the same at all samples; say another column, or "
            "`rate` instead of `time`"
        )
    return replace(time, since=since[0] + (since - since[0]) * (1 + source.skew))


def _streams(mapping: Mapping, folder: Path) -> dict[str, _Stream]:
    """Samples of all signals, by the label of their tables in the mapping."""
    files = {name: _open(folder, mapping, name) for name in _used(mapping)}
    clocks = {name: _times(mapping, name, file) for name, file in files.items()}
    times = by_one_clock(
        clocks, {name: mapping.sources[name].offset for name in clocks}
    )
    found = {
        label: _stream(label, table, files[table.source], times[table.source])
        for label, table in mapping.tables.items()
    }
    spans = sorted(
        (each.table.source, float(np.ptp(each.time))) for each in found.values()
    )
    longest = dict(spans)
    return {
        label: replace(
            each, shorter=longest[each.table.source] - float(np.ptp(each.time))
        )
        for label, each in found.items()
    }


def _stream(label: str, table: AnyTable, file: ForeignTable, time: Array) -> _Stream:
    """Samples of a signal, without incomplete ones.

    Raises:
        RecordingError: There are hardly any.
    """
    values = file.matrix(table.columns)
    finite = np.isfinite(values)
    rows = np.flatnonzero(finite.all(axis=1) & np.isfinite(time))
    if not len(rows) and finite.any(axis=0).all():
        rows, values = on_common_rows(time, values)
    if len(rows) < FEWEST:
        why = f"{plural(len(rows), 'sample')} of [{label}], which is no recording"
        for name in (
            n for n, some in zip(table.columns, finite.T, strict=True) if not some.any()
        ):
            why = f"'{name}' holds no number; leave [{label}] out"
        raise RecordingError(f"sources.{table.source}: {why}")
    begin = float(time[np.isfinite(time)][0])
    return _Stream(table, file, time[rows], values[rows], rows, begin)


def _window(mapping: Mapping, streams: Table[str, _Stream]) -> Window:
    """First and last time common to all signals and the requested interval [s]."""
    first = max(float(each.time.min()) for each in streams.values())
    last = min(float(each.time.max()) for each in streams.values())
    times = {each.table.source: each.time for each in streams.values()}
    if first >= last:
        ranges = "; ".join(
            f"{n} {t.min():.9g} to {t.max():.9g} s" for n, t in times.items()
        )
        own, *others = times
        together = ", ".join(
            f"[sources.{n}] offset = "
            f"{mapping.sources[n].offset + times[own].min() - times[n].min():.6g}"
            for n in others
        )
        raise RecordingError(
            f"the sources have no time in common: {ranges}; their clocks differ: {together} would "
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
    """Samples in a window and one beyond either end, repeated samples dropped."""
    table, time, name = stream.table, stream.time, stream.table.source
    source = mapping.sources[name]
    low, high = np.searchsorted(np.maximum.accumulate(time), window)
    near = slice(max(0, low - 1), min(high + 2, len(time)))
    part = without_gaps(source, time, stream.rows, near, window)
    if part.stop <= part.start:
        raise RecordingError(
            f"sources.{name}: time does not increase; say `rate` instead of `time`"
        )
    stamps, values, rows = time[part], stream.values[part], stream.rows[part]
    kept = without_repeats(name, stamps, values, steady=source.steady)
    stamps, values = stamps[kept], values[kept]
    used = steady_times(name, stamps, rows[kept]) if source.steady else stamps
    clock = clock_report(name, source, stamps, used, int(np.count_nonzero(~kept)))
    time, rate, held, dropped = used - table.delay, clock.rate, held_share(values), 0
    if source.drop_held:
        news = slow_device(values)
        dropped = int(np.count_nonzero(~news))
        time, values = time[news], values[news]
        rate = float(1 / np.median(np.diff(time)))
    if isinstance(table, BaseTable):
        values = np.hstack([values[:, :3], without_turnovers(values[:, 3:])])
    values = signed(table, values) if table is mapping.torque else values
    said: list[Diagnostic] = []
    if stream.shorter > longest_bridged(source, 1 / rate):
        said.append(diagnose("import.shorter", label, stream.shorter, source=name))
    if table is mapping.position:
        names = mapping.joints if table.matrix is None else table.columns
        values, steps = without_turns(table, names, time, values)
        said += steps
    passed = low_pass_reach(rate, mapping.rate) > 0
    report = SignalReport(name, held, dropped, passed, tuple(said))
    return _Samples(time, values, rate, clock, report)


def _grid(
    mapping: Mapping, samples: Iterable[_Samples], window: tuple[float, float]
) -> Array:
    """The recording's instants, (L,) [s]."""
    first, last = window
    for each in samples:
        lost = low_pass_reach(each.rate, mapping.rate)
        first, last = max(first, each.time[0] + lost), min(last, each.time[-1] - lost)
    wanted = 1 + 6 * len(mapping.joints)
    count = (last - first) * mapping.rate
    if not count * wanted <= MOST_NUMBERS:
        raise RecordingError(
            f"rate = {mapping.rate:g} Hz makes {count:.2g} samples, too many for memory"
        )
    if count < 2:
        raise RecordingError(
            f"{max(0.0, last - first):.3g} s are left of what the sources have in common, too "
            f"little for {mapping.rate:g} Hz; is `time_unit` right, and every source's `offset`?"
        )
    return first + np.arange(int(count + SAME * mapping.rate) + 1) / mapping.rate


def _mapped(mapping: Mapping, label: str, raw: Array) -> dict[str, Array]:
    """A signal on the grid as the recording's columns."""
    table = mapping.tables[label]
    signal, sensors = label, (label.removeprefix("sensors."),)
    if isinstance(table, SixAxisTable):
        found = wrench_of(table, raw)
        signal = "sensors" if isinstance(table, ForceSensorTable) else "wrench"
    elif isinstance(table, BaseTable):
        found = base_pose(table, raw)
    else:
        found = joint_signal(label, table, mapping.gear, raw)
    members = members_of(signal, tuple(mapping.joints), sensors)
    return {f"{signal}/{member}": found[:, k] for k, member in enumerate(members)}


def _metadata(mapping: Mapping, report: ImportReport) -> dict[str, Any]:
    """What the recording's file keeps beside its columns."""
    metadata = {
        "import": encode(report),
        "mapping": mapping.model_dump(mode="json", exclude_none=True),
        "diagnostics": [each.as_dict() for each in report.diagnostics],
        "sensors": {
            name: {"link": each.link or name} for name, each in mapping.sensors.items()
        },
        "geometry": joint_kinds(mapping.position, mapping.joints),
        "effort": effort_kinds(mapping),
        "gravity": mapping.gravity,
    }
    plates = [each for each in mapping.others.values() if isinstance(each, WrenchTable)]
    tares = [t for each in plates if (t := each.static(mapping.gravity)) is not None]
    tare = np.sum(tares, axis=0).tolist() if tares else None
    return {
        "tare": tare,
        "facts": {name: value for name, value in metadata.items() if value},
    }
