"""A mapping file to start from: what a foreign file holds; what only a person knows is empty."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.arrays import Array
from testbed.errors import RecordingError, printable
from testbed.recordings.importing.foreign_table import ForeignTable
from testbed.recordings.importing.foreign_units import KINDS, TIMES, UNITS
from testbed.recordings.importing.readers import open_foreign, reader_of

SHOWN = 100
"""Most columns of a source that are listed."""

WORDS = {
    "position": ("pos", "angle", "enc", "/q", "q[", "joint"),
    "velocity": ("vel", "speed", "qd", "dq"),
    "acceleration": ("acc", "qdd", "ddq"),
    "torque": ("torque", "tau", "effort", "cur", "trq"),
    "wrench": ("force", "wrench", "moment", "fx", "fy", "fz", "mx", "my", "mz", "ft[", "w["),
}
"""Parts of names by which columns are told apart."""

SYMBOLS = {
    "q": "position", "theta": "position", "qpos": "position",
    "qd": "velocity", "dq": "velocity", "qvel": "velocity", "qdot": "velocity",
    "qdd": "acceleration", "ddq": "acceleration", "qacc": "acceleration",
    "i": "torque", "tau": "torque",
    "quat": "base", "quaternion": "base", "orientation": "base", "pose": "base", "base": "base",
}  # fmt: skip
"""Words of names, whole, that say more than their parts."""

TIME_UNITS = {"sec": "s", "msec": "ms", "usec": "us", "nsec": "ns"} | {u: u for u in TIMES}
"""Words of names that say the unit of a time."""

EPOCH = 1e9
"""Seconds since 1970 are one to three times as many: times of that size tell their unit."""

TIME_WORDS = ("stamp", "time", "received", "sec", "t")
"""Names of times, or parts of them; the likeliest first."""

HEAD = """\
# What {file} holds, and how it becomes a recording. Fill in what is empty or 0, then
#   testbed import THIS.toml --out recording.parquet
# Units, the sense of the wrench and clocks have no defaults; see docs/real-recordings.md.
"""


@dataclass(frozen=True, eq=False)
class _Seen:
    """One source: its name, the bag's topic, its columns, and its likely clock."""

    name: str
    topic: str | None
    table: ForeignTable
    time: str | None
    rate: float
    time_unit: str | None = None


def guessed(path: Path, folder: Path) -> str:
    """A mapping in TOML with comments; as it is, `read_mapping` refuses it.

    Args:
        path: A file of another program.
        folder: Where the mapping is to stand: files are named relative to it.

    Raises:
        RecordingError: It cannot be read, or holds no columns.
        UnknownName: Its ending is that of no known format.
    """
    if "\0" in str(path) or not path.exists():
        raise RecordingError(f"there is no file '{path}'")
    seen = list(_sources(path))
    if not seen:
        raise RecordingError(f"'{path}' holds no columns of numbers")
    file = json.dumps(os.path.relpath(path.resolve(), folder.resolve()))
    rates = [each.rate for each in seen if each.rate]
    lines = [HEAD.format(file=printable(path.name, 100))]
    lines.append(f"rate = {max(rates, default=0.0):.6g}  # of the recording [Hz]")
    lines.append('joints = [""]  # as in the model file, in the order of the columns below')
    for each in seen:
        lines += ["", *_listed(each.table), f"[sources.{each.name}]", f"file = {file}"]
        lines += [f"topic = {json.dumps(each.topic)}"] if each.topic is not None else []
        lines += _clock(each)
    for kind in (*KINDS, "wrench", "base"):
        lines += _signal(kind, seen)
    return "\n".join(lines) + "\n"


def _sources(path: Path) -> Iterator[_Seen]:
    """A file's tables: one, or of a bag one a topic of numbers."""
    if reader_of(path) != "ros_bag":
        yield from _seen("log", None, open_foreign(path))
        return
    from testbed.recordings.importing.readers.ros_bag import topics

    for number, topic in enumerate(topics(path)):
        try:
            table = open_foreign(path, topic)
        except RecordingError:
            continue  # a topic of texts or pictures
        yield from _seen(f"topic{number}", topic, table)


def _seen(name: str, topic: str | None, table: ForeignTable) -> Iterator[_Seen]:
    """A table with its likely clock, unless it is empty."""
    if not table.columns:
        return
    stamps = dict.fromkeys(sorted(table.columns, key=_like_time))
    for column in list(stamps)[:3]:
        values = table.read([column])[column] if _like_time(column) < len(TIME_WORDS) else None
        if values is not None and len(values) > 1 and (np.diff(values) > 0).mean() > 0.5:
            steps = np.diff(values)
            step, unit = float(np.median(steps[steps > 0])), _time_unit(table, column, values)
            known = unit is not None or step < 1  # seconds, or nobody knows
            rate = 1 / (TIMES[unit or "s"] * step) if known else 0.0
            yield _Seen(name, topic, table, column, rate, unit)
            return
    yield _Seen(name, topic, table, None, 0.0)


def _time_unit(table: ForeignTable, column: str, values: Array) -> str | None:
    """The file's word for a time's unit, or what its name or its size says; None for nothing."""
    if table.unit(column) in TIMES:
        return table.unit(column)
    named = [TIME_UNITS[word] for word in _words(column) if word in TIME_UNITS]
    sized = [
        unit
        for unit in ("s", "ms", "us", "ns")
        if EPOCH < np.median(values) * TIMES[unit] < 3 * EPOCH
    ]
    return next(iter([*named[-1:], *sized]), None)


def _words(column: str) -> list[str]:
    """The words of a name, in small letters."""
    return re.findall("[a-z]+", column.lower())


def _like_time(column: str) -> int:
    """How little a name is one of times: its place among the words."""
    last = column.lower().rpartition("/")[2]
    for k, word in enumerate(TIME_WORDS):
        if word in last if len(word) > 1 else re.split(r"[^a-z0-9]", last)[0] == word:
            return k
    return len(TIME_WORDS)


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


def _clock(seen: _Seen) -> list[str]:
    """Keys of a source's clock."""
    if seen.time is None:
        return ["rate = 0  # no column looks like times: samples a second [Hz]"]
    unit, found = seen.table.unit(seen.time), seen.time_unit
    likely = "likely; " if found else ""
    said = [f'time_unit = "{found or ""}"  # {likely}{", ".join(TIMES)}']
    rate = f"  # {seen.rate:.6g} a second, by the median" if found else ""
    return [f"time = {json.dumps(seen.time)}{rate}", *(said if unit not in TIMES else [])]


def _signal(kind: str, seen: Sequence[_Seen]) -> list[str]:
    """A signal's table, if columns look like one."""
    for each in seen:
        columns = [c for c in each.table.columns if _kind(c) == kind and c != each.time]
        if not columns:
            continue
        lines = ["", f"[{kind}]", f'source = "{each.name}"', f"columns = {json.dumps(columns)}"]
        if kind == "wrench":
            forces, moments = ", ".join(UNITS["force"]), ", ".join(UNITS["moment"])
            return [
                *lines,
                f'units = ["", ""]  # {forces}; {moments}',
                'sense = ""  # on_robot (at rest upwards) or on_plate',
                "# place = { xyz = [0, 0, 0], rpy = [0, 0, 0] }  # of the sensor [m, rad]",
            ]
        if kind == "base":
            return [
                *lines[:3],
                f"# of these: {json.dumps(columns)}",
                'position = ["", "", ""]',
                'unit = ""  # m, cm, mm, inch',
                'quaternion = ["", "", "", ""]  # w, x, y, z, in this order',
            ]
        raw = "; or A, V, raw with gain = [N m each]" if kind == "torque" else ""
        return [*lines, f'unit = ""  # {", ".join(UNITS[kind])}{raw}']
    if kind not in ("position", "torque"):
        return []
    more = "" if kind == "position" else ", if there are any"
    return [
        "",
        f"# [{kind}]  # no column looks like it{more}",
        f'# source = "{seen[0].name}"',
        "# columns = []  # one a joint",
        f'# unit = ""  # {", ".join(UNITS[kind])}',
    ]


def _kind(column: str) -> str | None:
    """What a column looks like, by its name."""
    name, words = column.lower(), _words(column)
    if found := [SYMBOLS[word] for word in words if word in SYMBOLS]:
        return found[-1]
    order = ("wrench", "torque", "acceleration", "velocity", "position")
    return next((kind for kind in order if any(w in name for w in WORDS[kind])), None)
