"""A mapping file to start from: what foreign files hold; what only a person knows is empty."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, few, plural, printable
from testbed.importing.column_names import WARMTH, ColumnName, at_the_hand, grouped
from testbed.importing.foreign_table import (
    RAW,
    UNITS,
    ForeignTable,
    Kind,
    StatedPlate,
    plain,
)
from testbed.importing.import_report import MappingDraft
from testbed.importing.likely_signals import (
    BY_BOTH,
    PER_CENT,
    LikelySignal,
    LikelySource,
    likely_plates,
    likely_signals,
    likely_sources,
    values_of,
)

SHOWN = 100
"""Most columns of a source that are listed."""

Said = tuple[str, Any, str]
"""A key, its value, and what is said beside it."""


def guessed(
    paths: Sequence[Path],
    folder: Path,
    joints: Sequence[str] = (),
    subsets: Iterable[Sequence[str]] = (),
) -> MappingDraft:
    """A mapping to start from; where something is empty, `read_mapping` refuses it.

    Args:
        paths: Files of other programs.
        folder: Where the mapping is to stand: files are named relative to it.
        joints: Names in the robot's model, in its order; none if that is not known.
        subsets: Fewer of them, tried where columns do not fit all.

    Raises:
        RecordingError: One cannot be read, or they hold no columns.
        UnknownName: An ending is that of no known format.
    """
    sources = likely_sources(paths)
    if not sources:
        listed = ", ".join(f"'{path}'" for path in paths)
        raise RecordingError(f"no columns of numbers in {listed}")
    signals, joints = _fitting(sources, joints, subsets)
    by_name = {each.source.name: each.source for each in signals.values()}
    sources = [by_name.get(each.name, each) for each in sources]
    signals = {**signals, **_temperatures(sources, joints, signals)}
    files = ", ".join(printable(path.name, 100) for path in paths)
    draft = MappingDraft().remarking(
        "",
        f"# What {files} {'holds' if len(paths) == 1 else 'hold'}, made into a recording by",
        "#   testbed import THIS.toml --out recording.parquet --model ROBOT",
        "# once nothing is empty or 0. See docs/your-recording.md.",
        "",
    )
    rate = _rate(sources, signals)
    why = (
        ""
        if rate
        else f": {sources[0].clock.because}, and a log without times does not say it"
    )
    draft = draft.saying("", "rate", rate, f"of the recording [Hz]{why}")
    draft = draft.saying("", "joints", *_joints(signals, joints))
    plates = likely_plates(sources, signals)
    used = {each.source.name for each in signals.values()} | {
        each[1].name for each in plates
    }
    for each in sources:
        if each.name in used or not used:
            draft = _with_source(draft, each, folder)
        else:
            unused = f"{few(each.table.columns)} of {each.file.name} {each.topic or ''}"
            draft = draft.remarking("", f"# not used: {printable(unused)}")
        if not rate:  # then it is the recording's
            draft = draft.saying(f"sources.{each.name}", "rate", None)
    for kind in get_args(Kind):
        draft = _with_signal(draft, kind, signals, sources)
    names, alone = [name for name, _, _ in plates], len(plates) == 1
    for name, source, columns in plates:
        own = name if names.count(name) == 1 else f"{source.name} {name}"
        table = "wrench" if alone else f"plates.{_key(own)}"
        draft = draft.saying_all(table, _plate(source, columns, alone=alone))
    return draft


def _with_source(
    draft: MappingDraft, source: LikelySource, folder: Path
) -> MappingDraft:
    """Mapping with a source's table, and what its columns hold."""
    name = f"sources.{source.name}"
    file = os.path.relpath(source.file.resolve(), folder.resolve())
    known = [f"# {source.logger} names its columns like this"] if source.logger else []
    rows = max(source.table.lengths.values(), default=0)
    known += (
        [f"# the last line is incomplete: {rows} rows are read"]
        if source.table.cut
        else []
    )
    draft = draft.remarking(name, *known, *_listed(source.table))
    keys = [("file", file, ""), ("topic", source.topic, ""), *source.clock.said()]
    return draft.saying_all(name, keys)


def _fitting(
    sources: Sequence[LikelySource],
    joints: Sequence[str],
    subsets: Iterable[Sequence[str]],
) -> tuple[Mapping[Kind, LikelySignal], Sequence[str]]:
    """Signals of all joints, or of the first fewer ones that the columns fit; and these joints."""
    signals = likely_signals(sources, joints)
    for fewer in subsets:
        if signals and all(each.group.matched for each in signals.values()):
            break
        tried = likely_signals(sources, fewer)
        if any(each.group.matched for each in tried.values()):
            signals, joints = tried, fewer
    return signals, joints


def _rate(
    sources: Sequence[LikelySource], signals: Mapping[Kind, LikelySignal]
) -> float:
    """The positions' rate, else the highest."""
    if "position" in signals and (own := signals["position"].source.clock.rate):
        return own
    return max((each.clock.rate for each in sources), default=0.0)


def _joints(
    signals: Mapping[Kind, LikelySignal], joints: Sequence[str]
) -> tuple[Sequence[str], str]:
    """Names, by the model or by the columns."""
    about = "as in the model file, in the order of the columns below"
    group = next((each.group for each in signals.values()), None)
    if group is None:
        return list(joints) or [""], about
    missing = [name for name in joints if name not in group.names]
    if group.matched or not joints:
        plain = [name for name in group.names if not re.search("[A-Za-z]", name)]
        more = "" if plain or group.matched else "; these are by the columns' names"
        more += f"; no columns of {', '.join(missing)}" if missing else ""
        return [""] if plain else list(group.names), about + more
    found = f"{plural(len(group.names), 'column')} for {plural(len(joints), 'joint')}"
    return [""], f"{about}, {found}: {', '.join(joints)}"


def _listed(table: ForeignTable) -> Iterator[str]:
    """What the columns hold, as comments."""
    yield "# column, samples, from .. to, unit by the file"
    lengths = table.lengths
    for column in table.columns[:SHOWN]:
        try:
            held = _range(table.read([column])[column])
        except RecordingError as error:  # of a column that may not be needed
            held = str(error)
        yield (
            f"#   {printable(json.dumps(column), 80)}  {lengths[column]}  {held}  "
            f"{printable(table.unit(column) or '-', 20)}"
        )
    more = len(table.columns) - SHOWN
    if more > 0:
        yield f"#   and {more} more"


def _range(values: Array) -> str:
    finite = values[np.isfinite(values)]
    missing = (
        f" ({len(values) - len(finite)} no numbers)"
        if len(finite) < len(values)
        else ""
    )
    return (
        f"{finite.min():.4g} .. {finite.max():.4g}" if len(finite) else "nothing"
    ) + missing


def _with_signal(
    draft: MappingDraft,
    kind: Kind,
    signals: Mapping[Kind, LikelySignal],
    sources: Sequence[LikelySource],
) -> MappingDraft:
    """A signal's table, if columns look like one."""
    beside = [c.name for s in sources for c in s.columns if c.kind == kind and c.beside]
    if beside:
        draft = draft.remarking(
            kind, f"# left out, by their names: {json.dumps(beside)}"
        )
    if kind in signals:
        return draft.saying_all(kind, _signal(kind, signals[kind]))
    optional = ", if there are any" if kind != "position" else ""
    lines = [
        f"# [{kind}]  # no column looks like it{optional}",
        f'# source = "{sources[0].name}"',
        "# columns = []  # one a joint",
        f'# unit = ""  # {_listing(kind)}',
    ]
    return draft.remarking(kind, *lines) if kind in ("position", "torque") else draft


def _signal(kind: Kind, found: LikelySignal) -> Iterator[Said]:
    """A signal's keys."""
    others = (
        f"others that look like it: {json.dumps(found.others)}" if found.others else ""
    )
    yield "source", found.source.name, ""
    columns = [each.name for each in found.group.columns]
    yield "columns", columns, "; ".join(filter(None, (found.evidence, others)))
    yield from _unit(kind, found)
    n = len(columns)
    if found.counts:
        turns = np.diag(np.full(n, 1 / found.counts)).tolist()
        about = f"{found.counts} counts a turn, as of Dynamixel's and Feetech's servos"
        yield "matrix", turns, about
        yield (
            "offset",
            [round(-np.pi, 6)] * n,
            "ASSUMED: zero is in the middle of a turn",
        )
    if found.sign_bit:
        about = (
            f"values beyond {found.sign_bit - 1} have a sign bit, as of servos' loads"
        )
        yield "sign_bit", found.sign_bit, about
    yield "sign", list(found.sign) or None, BY_BOTH


def _unit(kind: Kind, found: LikelySignal) -> Iterator[Said]:
    """The unit of a signal's columns, if all are known, and what else it needs."""
    known = UNITS[kind] | (RAW if kind == "torque" else {})
    taken = [unit for unit in found.units if unit in known]
    raw = [unit for unit in taken if unit in RAW]
    if len(taken) < len(found.units) or 0 < len(raw) < len(taken):
        more = "; or A, V, raw with gain = [N m each]" * (kind == "torque")
        large = (
            float(np.nanmax(np.abs(values_of(found)))) if kind == "position" else 0.0
        )
        if PER_CENT[0] <= large <= PER_CENT[1]:
            more += "; per cent of each joint's range, as of SO arms: deg, matrix of ranges / 200"
        yield "unit", "", f"{_listing(kind)}{more}"
        return
    yield "unit", taken[0] if len(set(taken)) == 1 else taken, found.because
    if raw:
        yield "gain", "", f"torque of one {raw[0]}, joint by joint [N m]"


def _temperatures(
    sources: Sequence[LikelySource],
    joints: Sequence[str],
    signals: Mapping[Kind, LikelySignal],
) -> Mapping[Kind, LikelySignal]:
    """Temperatures of the drives, if every joint has one."""
    position = signals.get("position")
    names = list(joints) if position is None else list(position.group.names)
    for source in sources:
        columns = [c for c in source.columns if not WARMTH.isdisjoint(c.words)]
        for group in (each.of(names).like(names) for each in grouped(columns, names)):
            if list(group.names) == names:
                units, because = ("degC",) * len(names), "the only one that is known"
                return {
                    "temperature": LikelySignal(
                        source, group, (), units, because=because
                    )
                }
    return {}


def _key(name: str) -> str:
    """What distinguishes a plate from the others, as a key."""
    return re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "plate"


def _plate(
    source: LikelySource, columns: Sequence[ColumnName], *, alone: bool
) -> Iterator[Said]:
    """A plate's keys."""
    names = tuple(each.name for each in columns)
    none = StatedPlate("", names)
    stated = next((each for each in source.table.plates if each.columns == names), none)
    yield "source", source.name, ""
    six = "six are wanted: force x, y, z, moment x, y, z" * (
        len(columns) != 6 and stated is none
    )
    hand = "they look like those of a sensor at the tool: leave [wrench] out then"
    yield "columns", list(names), hand if at_the_hand(columns[0]) else six
    units = [_of_all(columns[:3], "force"), _of_all(columns[3:], "moment")]
    raw = next(
        (each.unit for each in columns if each.unit and plain(each.unit) in RAW), None
    )
    if raw or stated.matrix:
        about = (
            ""
            if stated.matrix
            else f"the file says {raw}: six rows, N and N m of one {raw}"
        )
        yield "units", ["N", "N m"], "by the matrix"
        yield "matrix", stated.matrix or "", about
    else:
        yield (
            "units",
            units,
            "" if all(units) else f"{_listing('force')}; {_listing('moment')}",
        )
    if stated is not none:
        yield "sense", "on_plate", "as in all files of its kind"
    else:
        pull = [
            f"; {json.dumps(each.name)} is "
            f"{np.nanmean(source.table.read([each.name])[each.name]):.4g} on average"
            for each in columns
            if each.role == (0, 2)
        ]
        yield "sense", "", f"on_robot (at rest upwards) or on_plate{''.join(pull)}"
    if (place := stated.place) is not None:
        yield (
            "place",
            place,
            "by the file, in the laboratory's frame: it must be the bedplate's",
        )
    elif alone:
        yield "# place", {"xyz": [0, 0, 0], "rpy": [0, 0, 0]}, "of the sensor [m, rad]"
    else:
        yield (
            "place",
            "",
            "of the sensor [m, rad], as { xyz = [0, 0, 0], rpy = [0, 0, 0] }",
        )


def _listing(kind: str) -> str:
    return ", ".join(UNITS[kind])


def _of_all(columns: Sequence[ColumnName], kind: str) -> str:
    """The unit of all columns; empty if they do not say one."""
    units = {plain(each.unit or "") for each in columns}
    return units.pop() if len(units) == 1 and units <= UNITS[kind].keys() else ""
