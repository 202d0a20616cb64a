"""A mapping file to start from: what foreign files hold; what only a person knows is empty."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from testbed.arrays import Array
from testbed.errors import RecordingError, printable
from testbed.recordings.importing.column_groups import at_the_hand
from testbed.recordings.importing.column_names import ColumnName
from testbed.recordings.importing.foreign_table import ForeignTable
from testbed.recordings.importing.foreign_units import KINDS, RAW, UNITS, Kind, plain
from testbed.recordings.importing.likely_signals import (
    BY_BOTH,
    LikelySignal,
    LikelySource,
    likely_plate,
    likely_signals,
    likely_sources,
    values_of,
)

SHOWN = 100
"""Most columns of a source that are listed."""

HEAD = """\
# What {files} {hold}, made into a recording. Fill in what is empty or 0, then
#   testbed import THIS.toml --out recording.parquet --model ROBOT
# What is filled in is by the columns' names, or as said; see docs/real-recordings.md.
"""


def guessed(paths: Sequence[Path], folder: Path, joints: Sequence[str] = ()) -> str:
    """A mapping in TOML with comments; where something is empty, `read_mapping` refuses it.

    Args:
        paths: Files of other programs.
        folder: Where the mapping is to stand: files are named relative to it.
        joints: Names in the robot's model, in its order; none if that is not known.

    Raises:
        RecordingError: One cannot be read, or they hold no columns.
        UnknownName: An ending is that of no known format.
    """
    for path in paths:
        if "\0" in str(path) or not path.exists():
            raise RecordingError(f"there is no file '{path}'")
    sources = likely_sources(paths)
    if not sources:
        listed = ", ".join(f"'{path}'" for path in paths)
        raise RecordingError(f"no columns of numbers in {listed}")
    signals = likely_signals(sources, joints)
    told = {each.source.name: each.source for each in signals.values()}
    sources = [told.get(each.name, each) for each in sources]
    plate = likely_plate(sources)
    files = ", ".join(printable(path.name, 100) for path in paths)
    lines = [HEAD.format(files=files, hold="holds" if len(paths) == 1 else "hold")]
    lines += [_rate(sources, signals), _joints(signals, joints)]
    for each in sources:
        lines += ["", *_listed(each.table), f"[sources.{each.name}]"]
        lines.append(f"file = {_text(os.path.relpath(each.file.resolve(), folder.resolve()))}")
        lines += [f"topic = {_text(each.topic)}"] if each.topic is not None else []
        lines += each.clock.lines()
    for kind in KINDS:
        lines += _signal_lines(kind, signals, sources)
    return "\n".join([*lines, *_plate_lines(plate), *_base_lines(sources)]) + "\n"


def _rate(sources: Sequence[LikelySource], signals: Mapping[Kind, LikelySignal]) -> str:
    """The positions' rate, else the highest."""
    rates = [each.clock.rate for each in sources if each.clock.rate]
    if "position" in signals:
        (own,) = (s.clock.rate for s in sources if s.name == signals["position"].source.name)
        rates = [own] if own else rates
    return f"rate = {max(rates, default=0.0):.9g}  # of the recording [Hz]"


def _joints(signals: Mapping[Kind, LikelySignal], joints: Sequence[str]) -> str:
    """Names, by the model or by the columns."""
    about = "as in the model file, in the order of the columns below"
    group = next((each.group for each in signals.values()), None)
    if group is None:
        return f"joints = {_text(list(joints) or [''])}  # {about}"
    missing = [name for name in joints if name not in group.names]
    if group.matched or not joints:
        plain = [name for name in group.names if not re.search("[A-Za-z]", name)]
        names = [""] if plain else list(group.names)
        more = "" if plain or group.matched else "; these are by the columns' names"
        more += f"; no columns of {', '.join(missing)}" if missing and group.matched else ""
        return f"joints = {_text(names)}  # {about}{printable(more, 200)}"
    return f'joints = [""]  # {about}: {printable(", ".join(joints), 300)}'


def _listed(table: ForeignTable) -> list[str]:
    """What the columns hold, as comments."""
    lines = ["# column, samples, from .. to, unit by the file"]
    lengths = table.lengths
    for column in table.columns[:SHOWN]:
        values = table.read([column])[column]
        lines.append(
            f"#   {printable(json.dumps(column), 80)}  {lengths[column]}  {_range(values)}  "
            f"{printable(table.unit(column) or '-', 20)}"
        )
    more = len(table.columns) - SHOWN
    return lines + [f"#   and {more} more"] * (more > 0)


def _range(values: Array) -> str:
    finite = values[np.isfinite(values)]
    missing = f" ({len(values) - len(finite)} no numbers)" if len(finite) < len(values) else ""
    return (f"{finite.min():.4g} .. {finite.max():.4g}" if len(finite) else "nothing") + missing


def _signal_lines(
    kind: Kind, signals: Mapping[Kind, LikelySignal], sources: Sequence[LikelySource]
) -> list[str]:
    """A signal's table, if columns look like one."""
    found = signals.get(kind)
    beside = [c.name for s in sources for c in s.columns if c.kind == kind and c.beside]
    said = [f"# left out, by their names: {_text(beside)}"] if beside else []
    if found is not None:
        columns = _text([each.name for each in found.group.columns])
        lines = ["", f"[{kind}]", f'source = "{found.source.name}"', f"columns = {columns}"]
        lines += [f"# others that look like it: {_text(list(found.others))}"] * bool(found.others)
        lines += [*said, *_unit_lines(kind, found)]
        return lines + [f"sign = {list(found.sign)}  # {BY_BOTH}"] * bool(found.sign)
    if kind not in ("position", "torque"):
        return []
    more = "" if kind == "position" else ", if there are any"
    return [
        "",
        f"# [{kind}]  # no column looks like it{more}",
        *said,
        f'# source = "{sources[0].name}"',
        "# columns = []  # one a joint",
        f'# unit = ""  # {", ".join(UNITS[kind])}',
    ]


def _unit_lines(kind: Kind, found: LikelySignal) -> list[str]:
    """The unit of a signal's columns, if all are known, and what else it needs."""
    known = UNITS[kind] | (RAW if kind == "torque" else {})
    taken = [unit for unit in found.units if unit in known]
    raw = [unit for unit in taken if unit in RAW]
    if len(taken) < len(found.units) or 0 < len(raw) < len(taken):
        more = "; or A, V, raw with gain = [N m each]" if kind == "torque" else ""
        large = float(np.nanmax(np.abs(values_of(found)))) if kind == "position" else 0.0
        more += f"; {large:.4g} rad would be more than a turn" if large > 2 * np.pi else ""
        return [f'unit = ""  # {", ".join(UNITS[kind])}{more}']
    unit = taken[0] if len(set(taken)) == 1 else taken
    lines = [f"unit = {_text(unit)}" + f"  # {found.because}" * bool(found.because)]
    gains = [f'gain = ""  # torque of one {each}, joint by joint [N m]' for each in raw[:1]]
    return lines + gains


def _plate_lines(plate: tuple[LikelySource, list[ColumnName]] | None) -> list[str]:
    """The wrench's table."""
    if plate is None:
        return []
    source, columns = plate
    units = [_of_all(columns[:3], "force"), _of_all(columns[3:], "moment")]
    forces, moments = ", ".join(UNITS["force"]), ", ".join(UNITS["moment"])
    said = "" if all(units) else f"  # {forces}; {moments}"
    lines = ["", "[wrench]", f'source = "{source.name}"']
    lines.append(f"columns = {_text([each.name for each in columns])}")
    if len(columns) != 6:
        lines.append("# six are wanted: force x, y, z, moment x, y, z")
    if at_the_hand(columns[0]):
        lines.append("# they look like those of a sensor at the tool: leave [wrench] out then")
    pull = [
        f"; {_text(each.name)} is {source.table.read([each.name])[each.name].mean():.4g} on average"
        for each in columns
        if each.role == (0, 2)
    ]
    return [
        *lines,
        f"units = {_text(units)}{said}",
        f'sense = ""  # on_robot (at rest upwards) or on_plate{printable("".join(pull), 200)}',
        "# place = { xyz = [0, 0, 0], rpy = [0, 0, 0] }  # of the sensor [m, rad]",
    ]


def _of_all(columns: Sequence[ColumnName], kind: str) -> str:
    """The unit of all columns; empty if they do not say one."""
    units = {plain(each.unit or "") for each in columns}
    return units.pop() if len(units) == 1 and units <= UNITS[kind].keys() else ""


def _base_lines(sources: Sequence[LikelySource]) -> list[str]:
    """The table of a base that moves, if columns look like it."""
    for source in sources:
        columns = [c.name for c in source.columns if c.kind == "base"]
        if columns:
            return [
                "",
                "[base]",
                f'source = "{source.name}"',
                f"# of these: {_text(columns)}",
                'position = ["", "", ""]',
                'unit = ""  # m, cm, mm, inch',
                'quaternion = ["", "", "", ""]  # w, x, y, z, in this order',
            ]
    return []


def _text(value: object) -> str:
    """A text or a list of texts as TOML writes it."""
    return json.dumps(value, ensure_ascii=True)
