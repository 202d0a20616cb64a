"""What the columns of foreign files likely are: signals of the joints, plates."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from testbed.core.base.arrays import Array
from testbed.importing.column_names import (
    ColumnName,
    Group,
    as_torques,
    at_the_hand,
    best_group,
    grouped,
    plate_columns,
    read_name,
    says_signal,
)
from testbed.importing.derivative import SURE, Slopes, slopes, unit_of
from testbed.importing.foreign_table import KINDS, UNITS, ForeignTable, Kind
from testbed.importing.known_layouts import layout_of
from testbed.importing.likely_clock import LikelyClock, clock_of
from testbed.importing.readers import tables
from testbed.importing.signal_maps import sign_bit_of

BY_SIZE = "by their size"
DEGREES = (4 * np.pi, 720.0)
"""Largest positions that are rather degrees than radians, and the largest that are degrees."""

PER_CENT = (99.0, 100.5)
"""Largest positions that are rather parts of a calibrated range, as LeRobot's of SO arms."""

COUNTS, COUNTED = 4096, 1000
"""Of a turn of servos (Dynamixel's X, Feetech's STS); from which whole numbers on they are seen."""

BY_BOTH = "by velocity and position"
"""How a unit or a sign is known that no name says."""


@dataclass(frozen=True, eq=False)
class LikelySource:
    """A table of a foreign file.

    Attributes:
        name: In the mapping.
        file: Where it is.
        topic: Of a bag.
        table: What it holds.
        columns: What their names say, without that of the times.
        clock: Its likely clock.
        logger: Whose names the columns have, if that is known.
    """

    name: str
    file: Path
    topic: str | None
    table: ForeignTable
    columns: tuple[ColumnName, ...]
    clock: LikelyClock
    logger: str = ""

    def values(self, group: Group) -> Array:
        """Columns of a group as the file holds them, (M, n).

        Args:
            group: Of the table.
        """
        return self.table.matrix([each.name for each in group.columns])


@dataclass(frozen=True, eq=False)
class LikelySignal:
    """The likely columns of a joints' signal.

    Attributes:
        source: Where they are.
        group: The columns.
        others: What looks like it, too.
        units: Column by column; None where unknown.
        sign: 1 or -1 a column; empty if all count the same way.
        because: What shows the units, if not the columns' names.
        counts: Of a turn, if the columns are a servo's whole numbers.
        evidence: What shows that these columns are the signal, if not their names.
        sign_bit: From which value on they are negative, if so; 0 else.
    """

    source: LikelySource
    group: Group
    others: tuple[str, ...]
    units: tuple[str | None, ...]
    sign: tuple[int, ...] = ()
    because: str = ""
    counts: int = 0
    evidence: str = ""
    sign_bit: int = 0


_Pair = tuple[str | None, str | None]


def likely_sources(paths: Sequence[Path]) -> list[LikelySource]:
    """Tables of foreign files with what their columns likely are.

    Args:
        paths: The files; of a bag every topic of numbers is a table.

    Raises:
        RecordingError: One cannot be read.
        UnknownName: An ending is that of no known format.
    """
    found: list[LikelySource] = []
    stems: list[str] = []
    for path in paths:
        stem = (
            re.sub(r"\W+", "_", path.name.partition(".")[0], flags=re.ASCII).strip("_")
            or "log"
        )
        name = f"{stem}_{len(stems)}" if stem in stems else stem
        stems.append(stem)
        found += _tables(path, name if len(paths) > 1 else "")
    return [by_file(each) for each in found]


def by_file(source: LikelySource) -> LikelySource:
    """A source whose columns say the joint only, with the signal that its file's name says.

    Args:
        source: As its columns' names state it.
    """
    kind = read_name(source.file.name.partition(".")[0]).kind
    assigned = any(
        says_signal(word) for column in source.columns for word in column.words
    )
    if kind not in KINDS or assigned:
        return source
    columns = (
        replace(each, kind=kind) if each.unit is None and each.role is None else each
        for each in source.columns
    )
    return replace(source, columns=tuple(columns))


def _tables(path: Path, name: str) -> Iterator[LikelySource]:
    """A file's tables: one, or of a bag one a topic of numbers."""
    found = tables(path)
    readable = {
        topic: each for topic, each in found.items() if isinstance(each, ForeignTable)
    }
    for error in found.values():
        if not readable and isinstance(error, Exception):
            raise error
    for number, (topic, table) in enumerate(readable.items()):
        own = f"{name}_topic{number}".strip("_") if topic else name or "log"
        counts = dict.fromkeys(map(max, table.shapes.values()))
        for k, count in enumerate(counts):  # sampled at other times
            shapes = {each: s for each, s in table.shapes.items() if max(s) == count}
            part = replace(table, shapes=shapes)
            yield _source(f"{own}_{k + 1}" if k else own, path, topic or None, part)


def _source(
    name: str, path: Path, topic: str | None, table: ForeignTable
) -> LikelySource:
    """A table with its likely clock and the columns that hold numbers."""
    layout = layout_of(table.columns)
    clock = clock_of(table, layout)
    names = [each for each in table.columns if each != clock.column]
    read = tuple(read_name(each, table.unit(each)) for each in names)
    read = layout.read(read) if layout else read
    filled = [
        c for c in read if not c.kind or np.isfinite(table.read([c.name])[c.name]).any()
    ]
    logger = layout.logger if layout else ""
    return LikelySource(name, path, topic, table, tuple(filled), clock, logger)


def _with_source(
    signals: Mapping[Kind, LikelySignal], old: LikelySource, new: LikelySource
) -> Mapping[Kind, LikelySignal]:
    """Signals of a source as those of another."""
    return {
        kind: replace(each, source=new) if each.source is old else each
        for kind, each in signals.items()
    }


def likely_signals(
    sources: Sequence[LikelySource], joints: Sequence[str]
) -> Mapping[Kind, LikelySignal]:
    """Of each kind the columns that are most likely the joints'.

    Args:
        sources: Where to look.
        joints: Names in the robot's model, in its order; none if that is not known.
    """
    found: dict[Kind, LikelySignal] = {}
    count = len(joints) or None
    for kind in KINDS:
        groups = [
            (group, source)
            for source in sources
            for group in grouped(
                [c for c in source.columns if _is(as_torques(c, joints), kind)], joints
            )
        ]
        best = best_group([group for group, _ in groups], count)
        if best is None:
            continue
        source = next(source for group, source in groups if group is best)
        found[kind] = _signal(source, best, joints, found)
        count = count or len(best.columns)
    for kind, source, group, evidence in _by_data(found, sources, joints):
        found[kind] = replace(_signal(source, group, joints, found), evidence=evidence)
    return _with_derivatives(_with_sizes(_with_counts(_with_own_rows(found))))


def _with_own_rows(signals: Mapping[Kind, LikelySignal]) -> Mapping[Kind, LikelySignal]:
    """Signals with the clock of the positions' rows, where others are of another device."""
    if (q := signals.get("position")) is None:
        return signals
    finite = np.isfinite(values_of(q))
    rows = np.asarray(finite.all(axis=1))
    if not rows.any():  # of several devices
        rows = finite[:, int(finite.sum(axis=0).argmax())]
    if rows.all():
        return signals
    table = q.source.table
    source = replace(q.source, clock=clock_of(table, layout_of(table.columns), rows))
    return _with_source(signals, q.source, source)


def _with_counts(signals: Mapping[Kind, LikelySignal]) -> Mapping[Kind, LikelySignal]:
    """Signals with integer torques of no unit read as loads of a servo."""
    if (tau := signals.get("torque")) is None or any(tau.units):
        return signals
    values = values_of(tau)
    values = values[np.isfinite(values).all(axis=1)]
    if (values != np.round(values)).any() or not values.any():
        return signals
    units = ("raw",) * len(tau.units)
    tau = replace(
        tau, units=units, because="whole numbers", sign_bit=sign_bit_of(values)
    )
    return {**signals, "torque": tau}


def _signal(
    source: LikelySource,
    group: Group,
    joints: Sequence[str],
    found: Mapping[Kind, LikelySignal],
) -> LikelySignal:
    """Signal of a group of columns, in the order of the joints or of the signals before."""
    kept = group.of(joints)
    kept = kept.like(next(iter(found.values())).group.names) if found else kept
    kind, taken = kept.columns[0].kind, set(kept.columns)
    others = [
        c.name for c in source.columns if kind and _is(c, kind) and c not in taken
    ]
    return LikelySignal(
        source, kept, tuple(others), tuple(c.unit for c in kept.columns)
    )


def _by_data(
    found: Mapping[Kind, LikelySignal],
    sources: Sequence[LikelySource],
    joints: Sequence[str],
) -> Iterator[tuple[Kind, LikelySource, Group, str]]:
    """Signals without known names: velocities by integration, torques by elimination.

    Columns of forces or moments without an axis are torques of joints if nothing else is.
    """
    named = next(iter(found.values()), None)
    count = len(named.group.columns) if named else len(joints)
    for source in sources:
        silent = [c for c in source.columns if c.kind is None and not c.beside]
        loads = [c for c in source.columns if c.kind == "wrench" and c.role is None]
        groups = {
            group.columns: group
            for columns in (silent, loads)
            for group in grouped(columns, joints)
            if len(group.columns) == count > 0
        }
        own = {k: each.group for k, each in found.items() if each.source is source}
        kinds: tuple[Kind, Kind] = ("position", "velocity")
        likely = ([own[k]] if k in own else [*groups.values()] for k in kinds)
        pairs = [
            (position, velocity)
            for position, velocity in product(*likely)
            if position is not velocity and _follows(source, position, velocity)
        ]
        for kind, group in zip(kinds, pairs[0] if pairs else (), strict=False):
            if kind not in own:
                yield kind, source, group, BY_BOTH
            groups.pop(group.columns, None)
        if "torque" not in found and len(groups) == 1 and (pairs or "position" in own):
            (left,) = groups.values()
            yield (
                "torque",
                source,
                left,
                "ASSUMED: no other columns are left, joint by joint",
            )


def _slopes(source: LikelySource, position: Group, velocity: Group) -> Slopes:
    """Increments of positions regressed on integrals of velocities; zeros if lengths differ."""
    values, rates = (source.values(group) for group in (position, velocity))
    time = source.clock.time(source.table, len(values))
    same = values.shape == rates.shape and len(values) == len(time)
    return slopes(values, rates, time) if same else Slopes(*np.zeros((2, 1, 1)))


def _follows(source: LikelySource, position: Group, velocity: Group) -> bool:
    """Whether columns are the derivatives of others at half of the joints or more."""
    sure = np.diagonal(_slopes(source, position, velocity).fit) > SURE
    return bool(2 * sure.sum() >= len(sure))


def _is(column: ColumnName, kind: str) -> bool:
    return column.kind == kind and not column.beside


def _followed(signals: Mapping[Kind, LikelySignal]) -> Array | None:
    """Increments of positions over integrals of velocities, (n,); None where none follows.

    That of a joint that hardly moves is nan.
    """
    q, v = signals.get("position"), signals.get("velocity")
    if q is None or v is None or q.source is not v.source or q.counts:
        return None
    found = _slopes(q.source, q.group, v.group)
    sure = np.diagonal(found.fit) > SURE
    return np.where(sure, np.diagonal(found.slope), np.nan) if sure.any() else None


def _with_derivatives(
    signals: Mapping[Kind, LikelySignal],
) -> Mapping[Kind, LikelySignal]:
    """Signals whose signs, units and clock follow from positions and velocities."""
    slope = _followed(signals)
    if slope is None:
        return signals
    q, v = signals["position"], signals["velocity"]
    if np.nanmin(slope) < 0:
        v = replace(v, sign=tuple(-1 if each < 0 else 1 for each in slope))
    clock, units, ratios = (
        q.source.clock,
        [*zip(q.units, v.units, strict=True)],
        np.abs(slope),
    )
    if clock.seconds is None:
        sizes = [
            ratio * UNITS["position"][a] / UNITS["velocity"][b]
            for (a, b), ratio in zip(units, ratios, strict=True)
            if a in UNITS["position"] and b in UNITS["velocity"] and np.isfinite(ratio)
        ]
        clock = clock.by_velocity(float(np.median(sizes))) if sizes else clock
    else:
        ratios[np.isnan(ratios)] = np.nanmedian(ratios)  # of joints that rest
        pairs = zip(units, ratios / clock.seconds, strict=True)
        units = [_pair(a, b, float(ratio)) for (a, b), ratio in pairs]
    own, rates = ([pair[k] for pair in units] for k in (0, 1))
    changed = {
        **signals,
        "position": _in_units(q, own),
        "velocity": _in_units(v, rates),
    }
    return _with_source(changed, q.source, replace(q.source, clock=clock))


def _pair(position: str | None, velocity: str | None, ratio: float) -> _Pair:
    """Units of both, by what one of the velocity's is in one of the position's a second."""
    if position in UNITS["position"] and velocity is None:
        return position, unit_of("velocity", ratio * UNITS["position"][position])
    if velocity in UNITS["velocity"] and position is None:
        return unit_of("position", UNITS["velocity"][velocity] / ratio), velocity
    if (
        position is None
        and velocity is None
        and unit_of("position", 1 / ratio) == "deg"
    ):
        return "deg", "rad/s"
    return position, velocity


def _in_units(signal: LikelySignal, units: Sequence[str | None]) -> LikelySignal:
    same = tuple(units) == signal.units
    return signal if same else replace(signal, units=tuple(units), because=BY_BOTH)


def _with_sizes(signals: Mapping[Kind, LikelySignal]) -> Mapping[Kind, LikelySignal]:
    """What the size of positions shows where nothing else does: degrees, counts of a servo."""
    if (q := signals.get("position")) is None:
        return signals
    values = values_of(q)
    values = values[np.isfinite(values)]
    largest, whole = (
        float(np.nanmax(np.abs(values))),
        bool((values == np.round(values)).all()),
    )
    if any(q.units) and not (q.source.logger and largest > DEGREES[0]):
        return signals  # loggers can be set to degrees
    if whole and COUNTED <= largest < COUNTS and values.min() >= 0:
        q = replace(q, units=("turn",) * len(q.units), because=BY_SIZE, counts=COUNTS)
    elif (
        DEGREES[0] < largest <= DEGREES[1] and not PER_CENT[0] <= largest <= PER_CENT[1]
    ):
        q = replace(q, units=("deg",) * len(q.units), because=BY_SIZE)
        v = signals.get("velocity")
        if v is not None and v.source.logger:
            signals = {**signals, "velocity": replace(v, units=(None,) * len(v.units))}
    return {**signals, "position": q}


def values_of(signal: LikelySignal) -> Array:
    """Columns of a signal as the file holds them, (M, n)."""
    return signal.source.values(signal.group)


def likely_plates(
    sources: Sequence[LikelySource], signals: Mapping[Kind, LikelySignal]
) -> list[tuple[str, LikelySource, list[ColumnName]]]:
    """Columns of all plates that have six; of the first source that has any, if torques are not.

    Args:
        sources: Where to look.
        signals: Of the joints, whose columns are no plate's.

    Returns:
        What distinguishes a plate from the others, its source and its columns.
    """
    if found := [each for source in sources for each in _stated_plates(source)]:
        return found
    found = []
    taken = {column.name for each in signals.values() for column in each.group.columns}
    for source in sources:
        columns = [
            c for c in source.columns if _is(c, "wrench") and c.name not in taken
        ]
        own = [c for c in columns if not at_the_hand(c)]
        if columns:
            found += [
                (n, source, each) for n, each in plate_columns(own or columns).items()
            ]
    six = [each for each in found if len(each[2]) == 6]
    whole = [each for each in six if not at_the_hand(each[2][0])]
    return whole or (six if "torque" in signals else found)[:1]


IDLE = 0.02
"""Part of the largest force that a plate shows on which nothing stands."""


def _stated_plates(
    source: LikelySource,
) -> Iterator[tuple[str, LikelySource, list[ColumnName]]]:
    """Plates that the file itself describes, but for those without a load."""
    table, by_name = source.table, {each.name: each for each in source.columns}
    plates = [each for each in table.plates if by_name.keys() >= set(each.columns)]
    sizes = [float(np.ptp([*table.read(each.columns[:3]).values()])) for each in plates]
    for plate, size in zip(plates, sizes, strict=True):
        if size >= IDLE * max(sizes):
            yield plate.name, source, [by_name[name] for name in plate.columns]
