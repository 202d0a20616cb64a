"""ROS bags: version 1 (.bag), version 2 (.mcap, .db3, or the folder of both).

The columns of a topic are the numbers of its messages, and two times in nanoseconds since 1970:
`stamp`, from the messages' headers, and `received`, when the bag got them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.errors import RecordingError, UnknownName
from testbed.recordings.importing.foreign_table import (
    MOST_NUMBERS,
    ForeignTable,
    library,
    readable,
)
from testbed.recordings.importing.readers.ros_messages import Definitions, numbers_of

STAMP = "header/stamp"
"""Where messages say when what they tell of was."""


def read_file(path: Path, topic: str | None) -> ForeignTable:
    """Columns of a topic.

    Args:
        path: The bag.
        topic: Of its topics.

    Raises:
        RecordingError: The bag is damaged, the topic's messages have different fields, or
            rosbags is not installed.
        UnknownName: There is no such topic.
    """
    with readable(path), _opened(path) as bag:
        known = [each for each in bag.connections if each.topic == topic]
        if not known:
            raise UnknownName("topic", str(topic), sorted({c.topic for c in bag.connections}))
        columns = _columns(path, bag, known)
    times = {name: "ns" for name, values in columns.items() if values.dtype.kind == "i"}
    shapes = {name: values.shape for name, values in columns.items() if len(values) > 1}
    return ForeignTable(path, shapes, columns.__getitem__, times)


def topics(path: Path) -> dict[str, tuple[str, int]]:
    """Type and number of messages of every topic of a bag.

    Args:
        path: The bag.

    Raises:
        RecordingError: The bag is damaged, or rosbags is not installed.
    """
    with readable(path), _opened(path) as bag:
        return {each.topic: (str(each.msgtype), int(each.msgcount)) for each in bag.connections}


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A bag, read message by message."""
    with library("rosbags"):
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    with (Reader1 if _version(path) == 1 else Reader2)(path) as bag:
        yield bag


def _version(path: Path) -> int:
    return 1 if path.suffix.lower() == ".bag" else 2


def _columns(path: Path, bag: Any, connections: list[Any]) -> dict[str, NDArray[Any]]:
    """Numbers of all messages by path, and their times."""
    version, definitions = _version(path), {c.id: _definitions(path, c) for c in connections}
    fields: tuple[str, ...] = ()
    rows: list[list[float]] = []
    whole: set[str] = set()
    received: list[int] = []
    for connection, when, data in bag.messages(connections=connections):
        found = numbers_of(data, connection.msgtype, definitions[connection.id], version)
        if not rows:
            fields = tuple(found)
            whole = {name for name, value in found.items() if isinstance(value, int)}
        if found.keys() != set(fields):
            other = sorted(set(fields) ^ found.keys())[:4]
            raise RecordingError(
                f"{path}: messages of one topic have different fields ({', '.join(other)})"
            )
        rows.append([found[name] for name in fields])
        received.append(when)
        if len(rows) * (len(fields) + 1) > MOST_NUMBERS:
            raise RecordingError(f"{path}: more than {MOST_NUMBERS:.0e} numbers")
    columns: dict[str, NDArray[Any]] = {}
    for k, name in enumerate(fields):
        kind = np.int64 if name in whole else np.float64
        columns[name] = np.array([row[k] for row in rows], dtype=kind)
    if STAMP in columns:
        columns = {"stamp": columns.pop(STAMP)} | columns
    return columns | {"received": np.array(received, dtype=np.int64)}


def _definitions(path: Path, connection: Any) -> Definitions:
    """Fields of a topic's type and of all that it holds, by the bag's word or the standard's."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    standard = get_typestore(Stores.ROS1_NOETIC if _version(path) == 1 else Stores.ROS2_HUMBLE)
    known: dict[str, Any] = dict(standard.fielddefs)
    if connection.msgdef.format == MessageDefinitionFormat.MSG:
        known |= get_types_from_msg(connection.msgdef.data, connection.msgtype)
    elif connection.msgdef.format == MessageDefinitionFormat.IDL:
        known |= get_types_from_idl(connection.msgdef.data)
    if connection.msgtype not in known:
        raise RecordingError(f"{path}: it does not say what a '{connection.msgtype}' is")
    return known
