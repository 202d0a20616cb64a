"""Numbers in messages, keyed by path, and tables of a topic's messages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import MAX_NUMBERS, ForeignTable, check_count

TIME_KEYS = (
    ("sec", "nsec"),
    ("sec", "nanosec"),
    ("secs", "nsecs"),
    ("seconds", "nanos"),
)
"""Keys of a time: seconds and nanoseconds."""

NAME_FIELDS = ("name", "names", "joint_names")
"""Fields with the names of the entries in other fields."""

MAX_NUMBERS_PER_MESSAGE = 200_000
"""Largest number of numbers in a message."""

STAMP_PATH = "header/stamp"
"""Path of the time stamp in messages."""

NumbersByPath = Mapping[str, float]
"""Numbers of a message by path."""


class Nanoseconds(int):
    """Time in a message, an integer with more digits than floating-point numbers."""


def message_numbers(message: Any) -> NumbersByPath:
    """Numbers of a message, keyed by path.

    Paths are, for example, position/elbow, joints/elbow/effort or wrench[2].

    Args:
        message: Nested dictionaries and lists.

    Raises:
        ValueError: The message has too many numbers.
    """
    numbers: dict[str, float] = {}
    for path, number in _numbers_by_path(message, "", ()):
        numbers[path] = number
        if len(numbers) > MAX_NUMBERS_PER_MESSAGE:
            raise ValueError("a message has too many parts")
    return numbers


def _numbers_by_path(
    content: Any, path: str, names: tuple[str, ...]
) -> Iterator[tuple[str, float]]:
    """Yield path and value of the numbers in a part of a message.

    Args:
        content: Part of the message.
        path: Path of the part.
        names: Names of the entries if the part is a list; otherwise empty.
    """
    if isinstance(content, dict):
        for keys in TIME_KEYS:
            seconds, nanoseconds = (content.get(key) for key in keys)
            if isinstance(seconds, int) and isinstance(nanoseconds, int):
                yield path or "time", Nanoseconds(seconds * 1_000_000_000 + nanoseconds)
                return
        lists = (_distinct_texts(content.get(key)) for key in NAME_FIELDS)
        entry_names = next((each for each in lists if each), ())
        for key, value in content.items():
            yield from _numbers_by_path(
                value, f"{path}/{key}" if path else str(key), entry_names
            )
    elif isinstance(content, list):
        entry_names = _distinct_texts(
            [each.get("name") if isinstance(each, dict) else None for each in content]
        )
        label = next(
            (each for each in (entry_names, names) if len(each) == len(content) > 0),
            None,
        )
        for k, value in enumerate(content):
            yield from _numbers_by_path(
                value, f"{path}/{label[k]}" if label else f"{path}[{k}]", ()
            )
    elif isinstance(content, int | float):
        yield path, content


def _distinct_texts(value: Any) -> tuple[str, ...]:
    """Entries of a list if all are distinct texts; otherwise empty."""
    texts = value if isinstance(value, list) else []
    distinct = {text for text in texts if isinstance(text, str)}
    return tuple(texts) if len(distinct) == len(texts) else ()


class MessageTableBuilder:
    """Table of the numbers in a topic's messages, with one row for each message.

    Messages from different nodes may have different fields: numbers that a message lacks are nan.

    Attributes:
        path: Path of the file.
    """

    def __init__(self, path: Path) -> None:
        """Create a table without messages."""
        self.path = path
        self._columns: dict[str, list[float]] = {}
        self._received: list[int] = []

    def add_message(self, received: int, numbers: NumbersByPath) -> None:
        """Append a row for a message.

        Args:
            received: Time of reception [ns].
            numbers: Numbers of the message, keyed by path.

        Raises:
            RecordingError: A list without names changed its length, or there are too many numbers.
        """
        count_before = len(self._received)
        different = (
            sorted(numbers.keys() ^ self._columns.keys()) if count_before else []
        )
        if list_entries := [name for name in different if "]" in name]:
            raise RecordingError(
                f"{self.path}: messages of one topic have different fields "
                f"({', '.join(list_entries[:4])})"
            )
        for name in numbers:
            self._columns.setdefault(name, [math.nan] * count_before)
        for name, values in self._columns.items():
            values.append(numbers.get(name, math.nan))
        self._received.append(received)
        count = (count_before + 1) * (len(self._columns) + 1)
        check_count(self.path, "numbers", count, MAX_NUMBERS)

    def table(self) -> ForeignTable:
        """Table of columns keyed by path, sorted by time of reception.

        The column "stamp" contains the message's own time stamps, and the column "received" the
        times of reception [ns]. The table is empty for fewer than two messages.
        """
        received = np.array(self._received, dtype=np.int64)
        order = np.argsort(received, kind="stable")
        columns: dict[str, NDArray[Any]] = {}
        units = {}
        for name in sorted(self._columns, key=lambda name: name != STAMP_PATH):
            label, values = "stamp" if name == STAMP_PATH else name, self._columns[name]
            array = np.array(values)
            columns[label] = (
                array if array.dtype.kind in "if" else array.astype(np.float64)
            )[order]
            if any(isinstance(each, Nanoseconds) for each in values):
                units[label] = "ns"
        columns["received"], units["received"] = received[order], "ns"
        return ForeignTable.table_from_arrays(
            self.path, columns if len(received) > 1 else {}, units
        )
