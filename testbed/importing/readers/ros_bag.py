"""ROS bags of version 1, and of version 2 in folders and SQLite.

Messages are decoded by the definitions of their types, of which no code is made.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from testbed.core.base.errors import RecordingError, UnknownName
from testbed.importing.foreign_table import (
    ForeignTable,
    Tables,
    check_count,
    library,
    readable,
    refusal,
)
from testbed.importing.readers.message_rows import MessageRows, Numbers, numbers_of

BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4
"""Kinds of nodes in a type's definition."""

BYTES, TEXTS = ("byte", "char", "octet"), ("string", "wstring")
"""Base types that are not named as in NumPy."""

HEADER = 4
"""Bytes before a message of ROS 2: its numbers stand at multiples of their size from there."""

MOST_UNPACKED, MOST_RATIO, AT_ONCE = 1_000_000_000, 100, 1 << 24
"""Bytes of unpacked files, and more for each packed byte; bytes unpacked at once."""

Decoder = Callable[[bytes], Numbers]
"""Numbers of a message by their paths."""


def tables(path: Path, topic: str | None) -> Tables:
    """Every topic of a bag, or one.

    Args:
        path: The bag.
        topic: The only one that is wanted; None for all.

    Raises:
        RecordingError: The bag is damaged, or rosbags is not installed.
        UnknownName: There is no such topic.
    """
    with library("rosbags"):
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    version = 1 if path.suffix.lower() == ".bag" else 2
    found: Tables = {}
    with readable(path):
        _check_unpacked(path)
        bag: Any
        with (Reader1 if version == 1 else Reader2)(path) as bag:
            known = dict.fromkeys(each.topic for each in bag.connections)
            if topic is not None and topic not in known:
                raise UnknownName("topic", topic, sorted(known))
            for name in known if topic is None else [topic]:
                own = [each for each in bag.connections if each.topic == name]
                try:
                    found[name] = _table(path, bag, own, version)
                except (
                    Exception
                ) as error:  # whatever a damaged message makes a library raise
                    found[name] = refusal(path, error)
    return found


def _check_unpacked(path: Path) -> None:
    """Refuse a bag whose packed files, which rosbags unpacks all at once, would fill the disk.

    Raises:
        RecordingError: They are too large, unpacked.
    """
    packed = list(path.glob("*.zstd"))
    most, total = (
        MOST_UNPACKED + MOST_RATIO * sum(each.stat().st_size for each in packed),
        0,
    )
    for each in packed:
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(
            each.open("rb"), closefd=True
        ) as content:
            while part := content.read(AT_ONCE):
                total += len(part)
                check_count(path, "unpacked bytes", total, most)


def _table(path: Path, bag: Any, connections: list[Any], version: int) -> ForeignTable:
    """Numbers of a topic's messages."""
    from rosbags.interfaces import MessageDefinitionFormat

    decoders, rows = {}, MessageRows(path)
    for each in connections:
        idl = each.msgdef.format == MessageDefinitionFormat.IDL
        decoders[each.id] = decoder_of(each.msgtype, each.msgdef.data, version, idl=idl)
    for connection, when, data in bag.messages(connections=connections):
        rows.add(when, decoders[connection.id](data))
    return rows.table()


Definitions = Mapping[str, tuple[Any, Sequence[tuple[str, tuple[Any, Any]]]]]
"""Fields by the name of a type, as rosbags gives them."""


def decoder_of(kind: str, text: str, version: int, *, idl: bool = False) -> Decoder:
    """Decoder of a type's messages, by its definition or the standard's.

    Args:
        kind: Name of the type.
        text: Its definition; empty where the file has none.
        version: Of ROS, 1 or 2.
        idl: Whether the text is in IDL.

    Raises:
        RecordingError: Neither defines it, or rosbags is not installed.
    """
    with library("rosbags"):
        from rosbags.typesys import (
            Stores,
            get_types_from_idl,
            get_types_from_msg,
            get_typestore,
        )
        from rosbags.typesys.msg import normalize_msgtype
    standard = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    kind, known = normalize_msgtype(kind), dict[str, Any](standard.fielddefs)
    if text:
        known |= get_types_from_idl(text) if idl else get_types_from_msg(text, kind)
    if kind not in known:
        raise RecordingError(f"the file does not say what a '{kind}' is")
    return lambda data: numbers_of(RosMessage(data, version).value(NAME, kind, known))


class RosMessage:
    """Reader of one serialized ROS message, from its front."""

    def __init__(self, data: bytes, version: int) -> None:
        """At the message's beginning.

        Args:
            data: As the bag holds it.
            version: Of ROS; the second byte of version 2 says the order of the others.
        """
        self._data, self._aligned = data, version == 2
        self._place = HEADER if self._aligned else 0
        self._order: Literal["<", ">"] = (
            ">" if self._aligned and not data[1] & 1 else "<"
        )

    def value(self, node: Any, what: Any, definitions: Definitions) -> Any:
        """The next value: a number, a text, a list, or a dictionary of a type's fields.

        Args:
            node: Its kind, as `BASE`.
            what: Its type, or that of its elements and their count.
            definitions: Of all types.

        Raises:
            ValueError: The message is damaged.
        """
        if node == NAME:
            return {
                name: self.value(*each, definitions)
                for name, each in definitions[what][1]
            }
        if node == BASE and what[0] in TEXTS:
            return self._text()
        if node == BASE:
            return self._numbers(what[0], 1).item()
        (inner, kind), count = what
        if node == SEQUENCE:
            count = self._numbers("uint32", 1).item()
        if inner == BASE and kind[0] not in TEXTS:
            return self._numbers(kind[0], count).tolist()
        if count > len(self._data):
            raise ValueError("a list in a message is longer than the message")
        return [self.value(inner, kind, definitions) for _ in range(count)]

    def _numbers(self, kind: str, count: int) -> np.ndarray[Any, Any]:
        """The next numbers of one kind."""
        dtype = np.dtype("uint8" if kind in BYTES else kind).newbyteorder(self._order)
        if self._aligned and count:
            self._place += -(self._place - HEADER) % dtype.itemsize
        found = np.frombuffer(self._data, dtype, count, self._place)
        self._place += found.nbytes
        return found

    def _text(self) -> str:
        """The next text."""
        length = self._numbers("uint32", 1).item()
        return (
            self._numbers("uint8", length)
            .tobytes()
            .rstrip(b"\0")
            .decode("utf-8", "replace")
        )
