"""From a mapping file to a recording's columns on a uniform grid: the room's front door."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from collections.abc import Mapping as Table
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.diagnostics import Diagnostic
from testbed.errors import RecordingError, plural
from testbed.recordings.columns import members_of
from testbed.recordings.importing.derivative import derivatives
from testbed.recordings.importing.encoder_steps import without_turns
from testbed.recordings.importing.foreign_table import MOST_NUMBERS, ForeignTable
from testbed.recordings.importing.import_report import ImportReport, SignalReport
from testbed.recordings.importing.mapping import (
    AnyTable,
    BaseTable,
    ForceSensorTable,
    Mapping,
    SignalTable,
    SixAxisTable,
    WrenchTable,
    read_mapping,
)
from testbed.recordings.importing.readers import open_foreign
from testbed.recordings.importing.signal_maps import (
    base_pose,
    check_file_units,
    effort_kinds,
    joint_kinds,
    joint_signal,
    without_turnovers,
    wrench_of,
)
from testbed.recordings.importing.source_clock import (
    ClockReport,
    Times,
    by_one_clock,
    clock_report,
    cut,
    held_share,
    sample_times,
    slow_device,
    steady_times,
    without_gaps,
    without_repeats,
)

PASSING, ATTENUATION = 0.7, 80.0
"""Part of half the grid's rate that passes; how much the rest is taken down [dB]."""

FASTER = 1.01
"""Times the grid's rate from which a source is faster."""

SAME = 3e-7
"""Instants so near are the same, and samples stay what they are, to the bit: seconds since 1970
are no finer as doubles [s]."""

UNEVEN = 0.01
"""Spread of sampling times, relative, from which splines are of lower degree: those of fifth
degree swing between uneven samples."""


def low_pass_reach(source_rate: float, rate: float) -> float:
    """How much of a source's ends the filter takes [s]; 0 without one.

    Args:
        source_rate: Samples a second of the source [Hz].
        rate: Of the grid [Hz].
    """
    if source_rate <= FASTER * rate:
        return 0.0
    return (_taps(source_rate, rate) // 2) / source_rate


def onto_grid(time: Array, values: Array, source_rate: float, grid: Array) -> Array:
    """A signal at the instants of a uniform grid, (L, k).

    Args:
        time: Of the samples, increasing, (M,) [s].
        values: (M, k).
        source_rate: Samples a second [Hz].
        grid: Within `time`, by `low_pass_reach` from its ends, (L,) [s].
    """
    rate = (len(grid) - 1) / (grid[-1] - grid[0])
    first = int(np.searchsorted(time, grid[0] - SAME))
    same = time[first : first + len(grid)]
    if len(same) == len(grid) and np.abs(same - grid).max() < SAME:
        return values[first : first + len(grid)]
    steps = np.diff(time)
    even = float(np.std(steps)) <= UNEVEN * float(np.median(steps))
    if source_rate > FASTER * rate:
        count = int(np.floor((time[-1] - time[0]) * source_rate)) + 1
        if not even or count < len(time):
            steady = np.minimum(time[0] + np.arange(count) / source_rate, time[-1])
            values, time = _spline(time, values, even)(steady), steady
        values, time = _filtered(values, time, source_rate, rate)
        even = True
    found: Array = _spline(time, values, even)(np.clip(grid, time[0], time[-1]))
    return found


def _spline(time: Array, values: Array, even: bool) -> Callable[[Array], Array]:
    from scipy.interpolate import make_interp_spline

    found: Callable[[Array], Array] = make_interp_spline(
        time, values, k=min(5 if even else 3, len(time) - 1)
    )
    return found


def _taps(source_rate: float, rate: float) -> int:
    """Length of the low-pass, odd, by Kaiser's rule."""
    width = np.pi * (1 - PASSING) * rate / source_rate
    return 2 * int(np.ceil((ATTENUATION - 7.95) / (2.285 * width) / 2)) + 1


def _filtered(values: Array, time: Array, source_rate: float, rate: float) -> tuple[Array, Array]:
    """A signal without what a slower grid cannot hold, where the filter has all it needs."""
    from scipy.signal import firwin, oaconvolve

    taps = _taps(source_rate, rate)
    cutoff = (1 + PASSING) / 2 * rate / source_rate
    weights = firwin(taps, cutoff, window=("kaiser", 0.1102 * (ATTENUATION - 8.7)))
    middle = values.mean(axis=0)
    found = oaconvolve(values - middle, weights[:, None], mode="valid", axes=0) + middle
    return found, time[taps // 2 : taps // 2 + len(found)]


@dataclass(frozen=True, eq=False)
class Imported:
    """A recording's columns, made of other programs' files.

    Attributes:
        columns: By name, (M,) each.
        metadata: `tare` and `facts`, as a recording's file keeps them.
        report: What was found on the way.
    """

    columns: Table[str, Array]
    metadata: Table[str, Any]
    report: ImportReport


@dataclass(frozen=True, eq=False)
class _Source:
    """Samples of one source: times, used columns by name, and its clock."""

    time: Array
    columns: Table[str, Array]
    clock: ClockReport


@dataclass(frozen=True, eq=False)
class _Samples:
    """A signal's columns, (M, k), and when and how they were sampled."""

    time: Array
    values: Array
    rate: float
    report: SignalReport


def imported(path: Path) -> Imported:
    """What a mapping file and the files that it names say.

    Args:
        path: The mapping file; files are relative to it.

    Raises:
        ExperimentError: The mapping is not understood.
        RecordingError: A file is missing or damaged, has no such columns, or its clock is none.
    """
    return converted(read_mapping(path), path.parent)


def converted(mapping: Mapping, folder: Path) -> Imported:
    """What the files that a mapping names say.

    Args:
        mapping: What their columns mean.
        folder: To which the files are relative.

    Raises:
        RecordingError: A file is missing or damaged, has no such columns, or its clock is none.
    """
    tables, times = _opened(mapping, folder)
    return _converted(mapping, tables, times, _window(mapping, times))


def converted_pieces(mapping: Mapping, folder: Path) -> tuple[list[Imported], list[Diagnostic]]:
    """The same, cut wherever a source was silent for too long.

    Args:
        mapping: What the files' columns mean.
        folder: To which the files are relative.

    Returns:
        One or more, in the order of time; and where they were cut.

    Raises:
        RecordingError: As `converted`; of a gap where no piece is long enough.
    """
    tables, times = _opened(mapping, folder)
    windows, said = cut(_window(mapping, times), mapping.sources, times)
    return [_converted(mapping, tables, times, each) for each in windows], said


def clock_ranges(mapping: Mapping, folder: Path) -> dict[str, tuple[float, float]]:
    """First and last instant of each source by its own clock, since an instant in common [s].

    Args:
        mapping: What the files' columns mean.
        folder: To which the files are relative.

    Raises:
        RecordingError: A file is missing or damaged, or its clock is none.
    """
    return {
        name: (float(t.min()), float(t.max())) for name, t in _opened(mapping, folder)[1].items()
    }


def _opened(mapping: Mapping, folder: Path) -> tuple[dict[str, ForeignTable], dict[str, Array]]:
    """The sources' files, and when their samples were taken."""
    tables = {name: _open(folder, mapping, name) for name in _used(mapping)}
    times = {name: _times(mapping, name, table) for name, table in tables.items()}
    return tables, by_one_clock(times, {name: mapping.sources[name].offset for name in times})


def _converted(
    mapping: Mapping,
    tables: Table[str, ForeignTable],
    times: Table[str, Array],
    window: tuple[float, float],
) -> Imported:
    """What the files say of a part of the time."""
    sources = {
        name: _read(mapping, name, table, times[name], window) for name, table in tables.items()
    }
    tables_of: dict[str, AnyTable] = dict(mapping.signals.items())
    tables_of |= mapping.others
    samples = {label: _samples(mapping, each, sources) for label, each in tables_of.items()}
    samples["position"] = _without_turns(mapping, samples["position"])
    grid = _grid(mapping, samples.values(), window)
    columns: dict[str, Array] = {"time": grid - grid[0]}
    for label, each in tables_of.items():
        _check_units(label, each, tables[each.source])
        got = samples[label]
        made = _mapped(mapping, label, onto_grid(got.time, got.values, got.rate, grid))
        columns |= {name: made[name] + columns.get(name, 0.0) for name in made}  # plates add up
    reports = {label: got.report for label, got in samples.items()}
    reports |= derivatives(mapping, columns, reports)
    leads = {name: float(grid[0] - times[name][0]) for name in sources}
    clocks = {name: replace(s.clock, lead=leads[name]) for name, s in sources.items()}
    report = ImportReport(mapping.rate, len(grid), clocks, reports)
    return Imported(columns, _metadata(mapping, report), report)


def _used(mapping: Mapping) -> dict[str, list[str]]:
    """Columns that are needed, by source."""
    found: dict[str, list[str]] = {}
    for table in (*mapping.signals.values(), *mapping.others.values()):
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
        said = ", ".join(f"'{column}' {count}" for column, count in list(counts.items())[:4])
        raise RecordingError(f"sources.{name}: columns of different lengths: {said}")
    return table


def _times(mapping: Mapping, name: str, table: ForeignTable) -> Times:
    """When a source's samples were taken by its clock, drift taken back."""
    source = mapping.sources[name]
    if source.time is None:
        first = _used(mapping)[name][0]
        table.read([first])
        time = sample_times(name, source, None, table.lengths[first], None)
    else:
        stamps = table.stamps(source.time)
        time = sample_times(name, source, stamps, len(stamps), table.unit(source.time))
    since = time.since
    if len(since) < 4:
        raise RecordingError(
            f"sources.{name}: {plural(len(since), 'sample')}, which is no recording"
        )
    if since.min() == since.max():
        raise RecordingError(
            f"sources.{name}: '{source.time}' is the same at all samples; say another column, or "
            "`rate` instead of `time`"
        )
    return replace(time, since=since[0] + (since - since[0]) * (1 + source.skew))


def _window(mapping: Mapping, times: Table[str, Array]) -> tuple[float, float]:
    """First and last instant that are wanted and that all sources have [s]."""
    first = max(float(time.min()) for time in times.values())
    last = min(float(time.max()) for time in times.values())
    if first >= last:
        ranges = "; ".join(f"{n} {t.min():.9g} to {t.max():.9g} s" for n, t in times.items())
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
        raise RecordingError(f"start = {mapping.start:g} s leaves nothing of the recording")
    return first, last


def _read(
    mapping: Mapping, name: str, table: ForeignTable, time: Array, window: tuple[float, float]
) -> _Source:
    """A source's samples in the window and one beyond at either end."""
    source, wanted = mapping.sources[name], list(dict.fromkeys(_used(mapping)[name]))
    columns = table.read(wanted)
    low, high = np.searchsorted(np.maximum.accumulate(time), window)
    part = slice(max(0, low - 1), min(high + 2, len(time)))
    part = without_gaps(source, time, part, window)
    if part.stop <= part.start:
        raise RecordingError(
            f"sources.{name}: time does not increase; say `rate` instead of `time`"
        )
    values = np.stack([columns[each][part] for each in wanted], axis=1)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        k, c = bad[0]
        more = f", one of {len(bad)} such" if len(bad) > 1 else ""
        raise RecordingError(
            f"sources.{name}: '{wanted[c]}' of '{source.file}' is {values[k, c]} at sample "
            f"{k + part.start}{more}; cut it out by `start` and `stop`, or repair the file"
        )
    kept = without_repeats(name, time[part], values)
    stamps, values = time[part][kept], values[kept]
    used = steady_times(name, stamps) if source.steady else stamps
    clock = clock_report(name, source, stamps, used, int(np.count_nonzero(~kept)))
    clock = replace(clock, cut=table.cut)
    return _Source(used, {c: values[:, k] for k, c in enumerate(wanted)}, clock)


def _samples(mapping: Mapping, table: AnyTable, sources: Table[str, _Source]) -> _Samples:
    """A signal's columns as they were sampled, those of a slow device once each."""
    source = sources[table.source]
    time, rate = source.time - table.delay, source.clock.rate
    values = np.stack([source.columns[name] for name in table.columns], axis=1)
    held, dropped = held_share(values), 0
    if mapping.sources[table.source].drop_held:
        news = slow_device(values)
        dropped = int(np.count_nonzero(~news))
        time, values = time[news], values[news]
        rate = float(1 / np.median(np.diff(time)))
    if isinstance(table, BaseTable):
        values = np.hstack([values[:, :3], without_turnovers(values[:, 3:])])
    passed = low_pass_reach(rate, mapping.rate) > 0
    return _Samples(time, values, rate, SignalReport(table.source, held, dropped, passed))


def _without_turns(mapping: Mapping, samples: _Samples) -> _Samples:
    """Positions of encoders that wrap, unwrapped."""
    table = mapping.position
    names = mapping.joints if table.matrix is None else table.columns
    values, said = without_turns(table, names, samples.time, samples.values)
    return replace(samples, values=values, report=replace(samples.report, diagnostics=said))


def _grid(mapping: Mapping, samples: Iterable[_Samples], window: tuple[float, float]) -> Array:
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
    found: Array = first + np.arange(int(count + SAME * mapping.rate) + 1) / mapping.rate
    return found


def _mapped(mapping: Mapping, label: str, raw: Array) -> dict[str, Array]:
    """A signal on the grid as the recording's columns."""
    table = mapping.others.get(label)
    sensors: tuple[str, ...] = ()
    if isinstance(table, SixAxisTable):
        signal, found = "wrench", wrench_of(table, raw)
        if isinstance(table, ForceSensorTable):
            signal, sensors = "sensors", (label.removeprefix("sensors."),)
    elif isinstance(table, BaseTable):
        signal, found = "base", base_pose(table, raw)
    else:
        (kind,) = (kind for kind in mapping.signals if kind == label)
        signal, found = label, joint_signal(kind, mapping.signals[kind], mapping.gear, raw)
    members = members_of(signal, tuple(mapping.joints), sensors)
    return {f"{signal}/{member}": found[:, k] for k, member in enumerate(members)}


def _check_units(label: str, table: AnyTable, file: ForeignTable) -> None:
    """Whether the file says the same units where it says any."""
    columns = table.columns
    if isinstance(table, BaseTable):
        check_file_units(label, "position", table.position, [table.unit] * 3, file)
    elif isinstance(table, SignalTable):
        if table.gain is None:
            units = table.unit if isinstance(table.unit, list) else [table.unit] * len(columns)
            check_file_units(label, label, columns, units, file)
    elif table.matrix is None:
        check_file_units(label, "force", columns[:3], [table.units[0]] * 3, file)
        check_file_units(label, "moment", columns[3:], [table.units[1]] * 3, file)


def _metadata(mapping: Mapping, report: ImportReport) -> dict[str, Any]:
    """What the recording's file keeps beside its columns."""
    said = mapping.model_dump(mode="json", exclude_none=True)
    facts: dict[str, Any] = {"import": report.as_dict(), "mapping": said}
    if report.diagnostics:
        facts["diagnostics"] = [each.as_dict() for each in report.diagnostics]
    if mapping.sensors:
        links = {name: table.link or name for name, table in mapping.sensors.items()}
        facts["sensors"] = {name: {"link": link} for name, link in links.items()}
    kinds = joint_kinds(mapping.position, mapping.joints)
    if kinds:
        facts["geometry"] = kinds
    if efforts := effort_kinds(mapping):
        facts["effort"] = efforts
    if mapping.gravity is not None:
        facts["gravity"] = list(mapping.gravity)
    plates = [each for each in mapping.others.values() if isinstance(each, WrenchTable)]
    tares = [t for each in plates if (t := each.static(mapping.gravity)) is not None]
    tare = np.sum(tares, axis=0).tolist() if tares else None
    return {"tare": tare, "facts": facts}
