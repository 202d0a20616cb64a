"""ROS bags of version 1, and of version 2 in folders and SQLite.

Numbers of messages by the definitions of their types; MCAP's messages are tables in the same way.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.errors import RecordingError, UnknownName
from testbed.importing.foreign_table import (
    MOST_NUMBERS,
    ForeignTable,
    Tables,
    check_count,
    library,
    readable,
    refusal,
)

BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4
"""Kinds of nodes in a type's definition."""

NUMBERS = {
    "bool": "?", "byte": "B", "char": "B", "octet": "B", "int8": "b", "uint8": "B", "int16": "h",
    "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f",
    "float64": "d",
}  # fmt: skip
"""Codes of numbers."""

TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
"""Types that are two whole numbers, seconds and nanoseconds."""

LISTS_OF_NAMES = ("name", "names", "joint_names")
"""Fields that name the entries of others."""

MOST_STEPS = 200_000
"""Parts of a message."""

MOST_UNPACKED, MOST_RATIO, AT_ONCE = 1_000_000_000, 100, 1 << 24
"""Bytes of unpacked files, and more for each packed byte; bytes unpacked at once."""

Numbers = Mapping[str, float]
"""Of a message, by their paths."""


class Nanoseconds(int):
    """A time among a message's numbers, which has more digits than they."""


Definitions = Mapping[str, tuple[Any, Sequence[tuple[str, tuple[Any, Any]]]]]
"""Fields by the name of a type, as rosbags gives them."""


class Message:
    """The bytes of one message, taken from the front.

    Attributes:
        data: All bytes.
        place: Of the next byte.
        steps: Parts taken so far.
    """

    def __init__(self, data: bytes, version: int) -> None:
        """At the message's beginning.

        Args:
            data: As the bag holds it.
            version: Of ROS. Numbers of version 2 stand at multiples of their size, counted from
                the fourth byte; the second one says their order.
        """
        self.data, self.place, self.steps = data, 0 if version == 1 else 4, 0
        self._start, self._aligned = self.place, version != 1
        self._order = "<" if version == 1 or data[1] & 1 else ">"

    def number(self, kind: str) -> float:
        """The next number."""
        return float(self.numbers(kind, 1)[0])

    def numbers(self, kind: str, count: int) -> np.ndarray[Any, Any]:
        """The next numbers of one kind."""
        self.steps += 1
        code = NUMBERS[kind]
        size = struct.calcsize(code)
        if self._aligned and count:
            self.place += -(self.place - self._start) % size
        if self.steps > MOST_STEPS or count * size > len(self.data) - self.place:
            raise ValueError("a message ends early, or has too many parts")
        kind = {"?": "?"}.get(code, self._order + code)
        found = np.frombuffer(self.data, kind, count, self.place)
        self.place += count * size
        return found

    def text(self) -> str:
        """The next text."""
        length = int(self.number("uint32"))
        raw = self.numbers("uint8", length).tobytes()
        return raw.rstrip(b"\0").decode("utf-8", "replace")


def numbers_of(data: bytes, kind: str, definitions: Definitions, version: int) -> dict[str, float]:
    """All numbers of a message, by path; times are whole numbers of nanoseconds.

    Args:
        data: As the bag holds it.
        kind: Name of its type.
        definitions: Of it and of all that it holds.
        version: Of ROS, 1 or 2.

    Raises:
        ValueError: It is damaged.
    """
    return _fields(Message(data, version), kind, definitions, "")


def _fields(message: Message, kind: str, definitions: Definitions, before: str) -> dict[str, float]:
    """Numbers of a message's part of a known type."""
    if kind in TIMES:
        second, nanosecond = definitions[kind][1]
        whole = int(message.number(second[1][1][0])) * 1_000_000_000
        count = whole + int(message.number(nanosecond[1][1][0]))
        return {before.rstrip("/"): Nanoseconds(count)}
    found: dict[str, float] = {}
    names: list[str] = []
    for name, (node, what) in definitions[kind][1]:
        value = _value(message, node, what, definitions, f"{before}{name}")
        if isinstance(value, list):
            names = value if name in LISTS_OF_NAMES else names
        elif isinstance(value, np.ndarray):
            by_name = len(names) == len(value) > 0
            labels = [f"/{each}" for each in names] if by_name else _places(len(value))
            found |= {
                f"{before}{name}{label}": float(v) for label, v in zip(labels, value, strict=True)
            }
        else:
            found |= value
    return found


def _value(
    message: Message, node: Any, what: Any, definitions: Definitions, path: str
) -> dict[str, float] | list[str] | np.ndarray[Any, Any]:
    """A field: numbers by path, texts, or an array."""
    if node == BASE:
        if what[0] in ("string", "wstring"):
            message.text()
            return {}
        return {path: message.number(what[0])}
    if node == NAME:
        return _fields(message, what, definitions, f"{path}/")
    (inner, kind), count = what
    if node == SEQUENCE:
        count = int(message.number("uint32"))
    if inner == BASE and kind[0] in NUMBERS:
        return message.numbers(kind[0], count)
    if count > len(message.data):
        raise ValueError("a list in a message is longer than the message")
    if inner == BASE:
        return [message.text() for _ in range(count)]
    found: dict[str, float] = {}
    for k in range(count):
        value = _value(message, inner, kind, definitions, f"{path}[{k}]")
        found |= value if isinstance(value, dict) else {}
        message.steps += 1
        if message.steps > MOST_STEPS:
            raise ValueError("a message has too many parts")
    return found


def _places(count: int) -> list[str]:
    return [f"[{k}]" for k in range(count)]


STAMP = "header/stamp"
"""Where messages say when it was."""


def tables(path: Path, topic: str | None) -> Tables:
    """Every topic of a bag, or one.

    Args:
        path: The bag.
        topic: The only one that is wanted; None for all.

    Raises:
        RecordingError: The bag is damaged, or rosbags is not installed.
        UnknownName: There is no such topic.
    """
    found: Tables = {}
    with readable(path), _opened(path) as bag:
        known = dict.fromkeys(each.topic for each in bag.connections)
        if topic is not None and topic not in known:
            raise UnknownName("topic", topic, sorted(known))
        for name in known if topic is None else [topic]:
            try:
                found[name] = _table(path, bag, [c for c in bag.connections if c.topic == name])
            except Exception as error:  # whatever a damaged message makes a library raise
                found[name] = refusal(path, error)
    return found


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A bag, read message by message."""
    with library("rosbags"):
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    _check_unpacked(path)
    with (Reader1 if _version(path) == 1 else Reader2)(path) as bag:
        yield bag


def _check_unpacked(path: Path) -> None:
    """Refuse a bag whose packed files, which rosbags unpacks all at once, would fill the disk.

    Raises:
        RecordingError: They are too large, unpacked.
    """
    packed = list(path.glob("*.zstd"))
    most, total = MOST_UNPACKED + MOST_RATIO * sum(each.stat().st_size for each in packed), 0
    for each in packed:
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(each.open("rb"), closefd=True) as content:
            while part := content.read(AT_ONCE):
                total += len(part)
                check_count(path, "unpacked bytes", total, most)


def _version(path: Path) -> int:
    return 1 if path.suffix.lower() == ".bag" else 2


def _table(path: Path, bag: Any, connections: list[Any]) -> ForeignTable:
    """Numbers of a topic's messages."""
    from rosbags.interfaces import MessageDefinitionFormat

    version, known, rows = _version(path), {}, Rows(path)
    for each in connections:
        idl = each.msgdef.format == MessageDefinitionFormat.IDL
        known[each.id] = definitions_of(each.msgtype, each.msgdef.data, version, idl=idl)
    for connection, when, data in bag.messages(connections=connections):
        rows.add(when, numbers_of(data, *known[connection.id], version))
    return rows.table()


class Rows:
    """Numbers of a topic's messages, one after the other.

    Messages of several nodes have different fields: a number that is not in a message is nan.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        """Without a message."""
        self.path = path
        self._times: dict[str, bool] = {}
        self._rows: list[list[float]] = []
        self._received: list[int] = []

    def add(self, when: int, found: Numbers) -> None:
        """A message.

        Args:
            when: It was received [ns].
            found: Its numbers.

        Raises:
            RecordingError: A list without names has another length than before, or there are too
                many numbers.
        """
        other = sorted(found.keys() ^ self._times.keys()) if self._rows else []
        if listed := [name for name in other if "]" in name]:
            raise RecordingError(
                f"{self.path}: messages of one topic have different fields "
                f"({', '.join(listed[:4])})"
            )
        if other or not self._rows:
            self._times |= {name: isinstance(each, Nanoseconds) for name, each in found.items()}
        self._rows.append([found.get(name, math.nan) for name in self._times])
        self._received.append(when)
        count = len(self._rows) * (len(self._times) + 1)
        check_count(self.path, "numbers", count, MOST_NUMBERS)

    def table(self) -> ForeignTable:
        """Columns by path, and their times, in the order of these."""
        received = np.array(self._received, dtype=np.int64)
        order = np.argsort(received, kind="stable")
        columns: dict[str, NDArray[Any]] = {}
        for k, name in enumerate(self._times):
            made = np.array([row[k] if k < len(row) else math.nan for row in self._rows])
            columns[name] = (made if made.dtype.kind in "if" else made.astype(np.float64))[order]
        if STAMP in columns:
            columns = {"stamp": columns.pop(STAMP)} | columns
        columns["received"] = received[order]
        times = {name: "ns" for name, is_time in self._times.items() if is_time}
        units = times | {"received": "ns"} | ({"stamp": "ns"} if STAMP in times else {})
        shapes = {name: values.shape for name, values in columns.items() if len(values) > 1}
        return ForeignTable(self.path, shapes, columns.__getitem__, units)


def definitions_of(
    kind: str, text: str, version: int, *, idl: bool = False
) -> tuple[str, Definitions]:
    """A type's name, and the fields of it and of all that it holds, by a text or the standard's.

    Args:
        kind: Name of the type.
        text: Its definition; empty where the file has none.
        version: Of ROS, 1 or 2.
        idl: Whether the text is in IDL.

    Raises:
        RecordingError: Neither defines it, or rosbags is not installed.
    """
    with library("rosbags"):
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
        from rosbags.typesys.msg import normalize_msgtype
    standard = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    kind, known = normalize_msgtype(kind), dict[str, Any](standard.fielddefs)
    if text:
        known |= get_types_from_idl(text) if idl else get_types_from_msg(text, kind)
    if kind not in known:
        raise RecordingError(f"the file does not say what a '{kind}' is")
    return kind, known
