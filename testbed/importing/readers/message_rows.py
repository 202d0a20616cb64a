"""Numbers of messages by their paths, and the messages of a topic as rows of a table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import MOST_NUMBERS, ForeignTable, check_count

SECONDS = (("sec", "nsec"), ("sec", "nanosec"), ("secs", "nsecs"), ("seconds", "nanos"))
"""Keys of a time: whole seconds, and nanoseconds."""

LISTS_OF_NAMES = ("name", "names", "joint_names")
"""Fields that name the entries of others."""

MOST_PARTS = 200_000
"""Numbers of a message."""

STAMP = "header/stamp"
"""Where messages say when it was."""

Numbers = Mapping[str, float]
"""Of a message, by their paths."""


class Nanoseconds(int):
    """A time among a message's numbers, which has more digits than they."""


def numbers_of(message: Any) -> Numbers:
    """All numbers of a message by path, as position/elbow, joints/elbow/effort, wrench[2].

    Args:
        message: Dictionaries and lists in each other.

    Raises:
        ValueError: It has too many.
    """
    found: dict[str, float] = {}
    for path, number in _walk(message, "", ()):
        found[path] = number
        if len(found) > MOST_PARTS:
            raise ValueError("a message has too many parts")
    return found


def _walk(
    content: Any, path: str, names: tuple[str, ...]
) -> Iterator[tuple[str, float]]:
    """Numbers of a part of a message by path; `names` are of the entries of a list."""
    if isinstance(content, dict):
        for keys in SECONDS:
            second, rest = (content.get(key) for key in keys)
            if isinstance(second, int) and isinstance(rest, int):
                yield path or "time", Nanoseconds(second * 1_000_000_000 + rest)
                return
        lists = (_texts(content.get(key)) for key in LISTS_OF_NAMES)
        own = next((each for each in lists if each), ())
        for key, value in content.items():
            yield from _walk(value, f"{path}/{key}" if path else str(key), own)
    elif isinstance(content, list):
        own = _texts(
            [each.get("name") if isinstance(each, dict) else None for each in content]
        )
        label = next(
            (each for each in (own, names) if len(each) == len(content) > 0), None
        )
        for k, value in enumerate(content):
            yield from _walk(
                value, f"{path}/{label[k]}" if label else f"{path}[{k}]", ()
            )
    elif isinstance(content, int | float):
        yield path, content


def _texts(value: Any) -> tuple[str, ...]:
    """A list of texts that are not alike; else nothing."""
    texts = value if isinstance(value, list) else []
    distinct = {text for text in texts if isinstance(text, str)}
    return tuple(texts) if len(distinct) == len(texts) else ()


class MessageRows:
    """Table of the numbers in a topic's messages, a row a message.

    Messages of several nodes have different fields: a number that is not in a message is nan.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        """Without a message."""
        self.path = path
        self._columns: dict[str, list[float]] = {}
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
        before = len(self._received)
        other = sorted(found.keys() ^ self._columns.keys()) if before else []
        if listed := [name for name in other if "]" in name]:
            raise RecordingError(
                f"{self.path}: messages of one topic have different fields "
                f"({', '.join(listed[:4])})"
            )
        for name in found:
            self._columns.setdefault(name, [math.nan] * before)
        for name, values in self._columns.items():
            values.append(found.get(name, math.nan))
        self._received.append(when)
        count = (before + 1) * (len(self._columns) + 1)
        check_count(self.path, "numbers", count, MOST_NUMBERS)

    def table(self) -> ForeignTable:
        """Columns by path, and their times, in the order of these."""
        received = np.array(self._received, dtype=np.int64)
        order = np.argsort(received, kind="stable")
        columns: dict[str, NDArray[Any]] = {}
        units = {}
        for name in sorted(self._columns, key=lambda name: name != STAMP):
            label, values = "stamp" if name == STAMP else name, self._columns[name]
            made = np.array(values)
            columns[label] = (
                made if made.dtype.kind in "if" else made.astype(np.float64)
            )[order]
            if any(isinstance(each, Nanoseconds) for each in values):
                units[label] = "ns"
        columns["received"], units["received"] = received[order], "ns"
        return ForeignTable.of(self.path, columns if len(received) > 1 else {}, units)
