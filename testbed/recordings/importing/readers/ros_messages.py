"""Numbers of ROS messages, by the definitions of their types: nothing is compiled.

A message becomes numbers by path: header/stamp [ns], wrench/force/x, data[3]. Where a field
called `name` lists names, fields of that many numbers are named by them: position/elbow.

Source    ROS 1 serialization; OMG DDS-XTypes, plain CDR of version 1, for ROS 2
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

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
        return {before.rstrip("/"): whole + int(message.number(nanosecond[1][1][0]))}
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
