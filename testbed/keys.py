"""What may stand under a key of a kind's table: numbers within bounds, lists, tables by joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from testbed.errors import SettingsError

LARGEST = 1e9
"""Sizes beyond this are a mistake; so are positive ones below its inverse."""

COUNTS = {"axes": 3, "channels": 6}
"""How many members a list has that is not of joints."""

_LISTS = {
    "axes": ", or a list of three (x, y, z)",
    "channels": ", or a list of six (Fx, Fy, Fz, Mx, My, Mz)",
    "joints": ", a list of one a joint, or a table by joint name",
}


@dataclass(frozen=True)
class Key:
    """What may stand under a key of a kind's table.

    Attributes:
        members: What the value may be one of each for: "joints", "axes", "channels"; or
            "matrix" (6, 6); "word", a word instead of a number; or nothing.
        drawn: What a single number leaves open: "sign", "phase" (where the value is left
            out), or nothing.
        least: Smallest value.
        most: Largest value.
        positive: Zero is none either.
        whole: A whole number.
    """

    members: str = ""
    drawn: str = ""
    least: float = -LARGEST
    most: float = LARGEST
    positive: bool = False
    whole: bool = False

    def checked(self, value: Any, label: str) -> Any:
        """A value as it is kept: floats, tuples, tables by joint name.

        Args:
            value: As Python or TOML gives it.
            label: What it is called in the error.

        Raises:
            SettingsError: It is none that the key takes.
        """
        try:
            return self._kept(value)
        except (TypeError, ValueError, OverflowError):
            said = repr(value)
            said = said if len(said) <= 60 else f"{said[:60]}..."
            raise SettingsError(f"{label} is {self._words()}, found {said}") from None

    def _kept(self, value: Any) -> Any:
        if self.members == "word":
            if not isinstance(value, str):
                raise TypeError
            return value
        if self.members == "matrix":
            rows = tuple(tuple(self._number(each) for each in row) for row in value)
            if [len(row) for row in rows] != [6] * 6:
                raise ValueError
            return rows
        if isinstance(value, Mapping) and self.members == "joints":
            return {str(joint): self._number(each) for joint, each in value.items()}
        if isinstance(value, list | tuple) and self.members:
            if len(value) != COUNTS.get(self.members, len(value)) or not value:
                raise ValueError
            return tuple(self._number(each) for each in value)
        return self._number(value)

    def _number(self, value: Any) -> float | int:
        """A number within bounds."""
        if isinstance(value, bool | str | bytes):
            raise TypeError
        number = float(value)
        least = 1 / LARGEST if self.positive else self.least
        if not least <= number <= self.most or (self.whole and number != int(value)):
            raise ValueError
        return int(value) if self.whole else number

    def _words(self) -> str:
        """What the key takes."""
        if self.members == "word":
            return "a name"
        if self.members == "matrix":
            return "six lists of six numbers"
        number = "positive " * self.positive + "whole " * self.whole + "number"
        bounds = []
        if self.least > -LARGEST:
            bounds.append(f"at least {self.least:g}")
        if self.most < LARGEST:
            bounds.append(f"at most {self.most:g}")
        return f"a {number} {' and '.join(bounds)}".strip() + _LISTS.get(self.members, "")


def key(default: Any, members: str = "", drawn: str = "", **bounds: Any) -> Any:
    """A field that is a key of its kind's table.

    Args:
        default: Its value; None where nothing need be said.
        members: As in `Key`.
        drawn: As in `Key`.
        bounds: As in `Key`.
    """
    return field(default=default, metadata={"key": Key(members, drawn, **bounds)})


def hidden(default: Any) -> Any:
    """A field that is no key: what the value is installed on decides it."""
    return field(default=default, repr=False, compare=False, metadata={"rig": True})
