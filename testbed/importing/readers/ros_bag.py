"""ROS bags of version 1, and of version 2 in folders and SQLite files.

Messages are decoded according to the definitions of their types; no code is generated from the
definitions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from testbed.core.base.errors import RecordingError, UnknownName
from testbed.importing.foreign_table import (
    ForeignTable,
    TablesByTopic,
    check_count,
    optional_package,
    reading_error,
    reading_errors_as_recording_errors,
)
from testbed.importing.readers.message_rows import (
    MessageTableBuilder,
    NumbersByPath,
    message_numbers,
)

BASE_NODE, NAME_NODE, ARRAY_NODE, SEQUENCE_NODE = 1, 2, 3, 4
"""Kinds of nodes in the definition of a type."""

BYTE_TYPES, TEXT_TYPES = ("byte", "char", "octet"), ("string", "wstring")
"""Base types whose names differ from NumPy's: bytes and texts."""

HEADER_BYTES = 4
"""Bytes before a message of ROS 2; numbers are aligned to their size from there."""

MAX_UNPACKED_BYTES, MAX_UNPACKED_RATIO, CHUNK_BYTES = 1_000_000_000, 100, 1 << 24
"""Largest size of unpacked files [bytes], further bytes for each packed byte, and bytes unpacked in
one step."""

MessageDecoder = Callable[[bytes], NumbersByPath]
"""Function from a serialised message to its numbers by path."""


def tables(path: Path, topic: str | None) -> TablesByTopic:
    """Tables of a bag's topics, with one row for each message.

    Args:
        path: Path of the bag.
        topic: Topic of a single table; None for all tables.

    Raises:
        RecordingError: The bag is damaged, or rosbags is not installed.
        UnknownName: There is no such topic.
    """
    with optional_package("rosbags"):
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    version = 1 if path.suffix.lower() == ".bag" else 2
    contents: TablesByTopic = {}
    with reading_errors_as_recording_errors(path):
        _check_unpacked_size(path)
        bag: Any
        with (Reader1 if version == 1 else Reader2)(path) as bag:
            known = dict.fromkeys(each.topic for each in bag.connections)
            if topic is not None and topic not in known:
                raise UnknownName("topic", topic, sorted(known))
            for name in known if topic is None else [topic]:
                connections = [each for each in bag.connections if each.topic == name]
                try:
                    contents[name] = _topic_table(path, bag, connections, version)
                except (
                    Exception
                ) as error:  # damaged messages cause exceptions of any type
                    contents[name] = reading_error(path, error)
    return contents


def _check_unpacked_size(path: Path) -> None:
    """Refuse a bag whose compressed files are too large after decompression.

    The library rosbags decompresses whole files, which could fill the disk.

    Raises:
        RecordingError: The files are too large.
    """
    packed_files = list(path.glob("*.zstd"))
    maximum, total = (
        MAX_UNPACKED_BYTES
        + MAX_UNPACKED_RATIO * sum(each.stat().st_size for each in packed_files),
        0,
    )
    for each in packed_files:
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(
            each.open("rb"), closefd=True
        ) as content:
            while part := content.read(CHUNK_BYTES):
                total += len(part)
                check_count(path, "unpacked bytes", total, maximum)


def _topic_table(
    path: Path, bag: Any, connections: list[Any], version: int
) -> ForeignTable:
    """Table of the numbers in a topic's messages."""
    from rosbags.interfaces import MessageDefinitionFormat

    decoders, rows = {}, MessageTableBuilder(path)
    for each in connections:
        idl = each.msgdef.format == MessageDefinitionFormat.IDL
        decoders[each.id] = ros_message_decoder(
            each.msgtype, each.msgdef.data, version, idl=idl
        )
    for connection, received, data in bag.messages(connections=connections):
        rows.add_message(received, decoders[connection.id](data))
    return rows.table()


Definitions = Mapping[str, tuple[Any, Sequence[tuple[str, tuple[Any, Any]]]]]
"""Fields by the name of a type, as in rosbags."""


def ros_message_decoder(
    kind: str, text: str, version: int, *, idl: bool = False
) -> MessageDecoder:
    """Decoder for a type's messages, based on the given or the standard definition.

    Args:
        kind: Name of the type.
        text: Definition of the type; empty if the file has no definition.
        version: Version of ROS, 1 or 2.
        idl: True if the definition is in IDL.

    Raises:
        RecordingError: The type is not defined, or rosbags is not installed.
    """
    with optional_package("rosbags"):
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
    return lambda data: message_numbers(
        RosMessage(data, version).value(NAME_NODE, kind, known)
    )


class RosMessage:
    """Sequential reader of one serialised ROS message."""

    def __init__(self, data: bytes, version: int) -> None:
        """Start reading at the beginning of a message.

        Args:
            data: Message as in the bag.
            version: Version of ROS, 1 or 2; in version 2 the second byte states the byte order.
        """
        self._data, self._aligned = data, version == 2
        self._place = HEADER_BYTES if self._aligned else 0
        self._order: Literal["<", ">"] = (
            ">" if self._aligned and not data[1] & 1 else "<"
        )

    def value(self, node: Any, node_type: Any, definitions: Definitions) -> Any:
        """Read the next value: number, text, list, or dictionary of fields.

        Args:
            node: Kind of the node, for example `BASE_NODE`.
            node_type: Type of the value, or type of the elements and their number.
            definitions: Definitions of all types.

        Raises:
            ValueError: The message is damaged.
        """
        if node == NAME_NODE:
            return {
                name: self.value(*each, definitions)
                for name, each in definitions[node_type][1]
            }
        if node == BASE_NODE and node_type[0] in TEXT_TYPES:
            return self._next_text()
        if node == BASE_NODE:
            return self._next_numbers(node_type[0], 1).item()
        (element_node, element_type), count = node_type
        if node == SEQUENCE_NODE:
            count = self._next_numbers("uint32", 1).item()
        if element_node == BASE_NODE and element_type[0] not in TEXT_TYPES:
            return self._next_numbers(element_type[0], count).tolist()
        if count > len(self._data):
            raise ValueError("a list in a message is longer than the message")
        return [
            self.value(element_node, element_type, definitions) for _ in range(count)
        ]

    def _next_numbers(self, kind: str, count: int) -> np.ndarray[Any, Any]:
        """Read the next numbers of one type."""
        dtype = np.dtype("uint8" if kind in BYTE_TYPES else kind).newbyteorder(
            self._order
        )
        if self._aligned and count:
            self._place += -(self._place - HEADER_BYTES) % dtype.itemsize
        values = np.frombuffer(self._data, dtype, count, self._place)
        self._place += values.nbytes
        return values

    def _next_text(self) -> str:
        """Read the next text."""
        length = self._next_numbers("uint32", 1).item()
        return (
            self._next_numbers("uint8", length)
            .tobytes()
            .rstrip(b"\0")
            .decode("utf-8", "replace")
        )
