"""A value that a file says as a table: its kind, and keys with defaults and bounds.

A kind is one frozen dataclass: `kind` as a class variable, a field a key. Faults of instruments
and effects in the plant are such values. What there is to say of a kind is in its docstring: a
sentence, details, the source of the default size, and the keys.

A single number where a kind has one for every joint holds for all; a list gives each its own; in a
table by joint name those left out have zero, or the default where zero makes no sense.
"""

from __future__ import annotations

from abc import ABC
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, fields
from functools import cache
from typing import Annotated, Any, ClassVar, TypeAlias, get_args, get_type_hints

import numpy as np
from annotated_types import Ge, Gt, Le

from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError, UnknownName
from testbed.core.base.summary_table import Value

LARGEST = 1e9
"""Sizes beyond this are a mistake; so are positive ones below its inverse."""


@dataclass(frozen=True)
class Each:
    """Mark of a key's type: one value for all members, or one each.

    Attributes:
        members: "joints", "axes" or "channels".
    """

    members: str


@dataclass(frozen=True)
class Sample:
    """Mark of a key's type: what is drawn where a single number leaves it open.

    Attributes:
        what: "sign", or "phase" where the value is left out.
    """

    what: str


SIGN, PHASE = Sample("sign"), Sample("phase")

PerJoint: TypeAlias = Annotated[
    float | tuple[float, ...] | Mapping[str, float], Each("joints")
]
"""One for all joints, one a joint in their order, or by name."""
PerAxis: TypeAlias = Annotated[float | tuple[float, ...], Each("axes")]
"""One for x, y and z, or three."""
PerChannel: TypeAlias = Annotated[float | tuple[float, ...], Each("channels")]
"""One for all channels of the plate, or six: Fx, Fy, Fz, Mx, My, Mz."""
Matrix: TypeAlias = Annotated[tuple[tuple[float, ...], ...], Each("matrix")]
"""Six rows of six."""

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
        sample: What a single number leaves open: "sign", "phase" (where the value is left
            out), or nothing.
        least: Smallest value.
        most: Largest value.
        positive: Zero is none either.
        whole: A whole number.
    """

    members: str = ""
    sample: str = ""
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
        return f"a {number} {' and '.join(bounds)}".strip() + _LISTS.get(
            self.members, ""
        )


@cache
def _keys(kind: type) -> dict[str, Key]:
    """Keys of a kind, by the types of its fields; fields without repr are none."""
    hints = get_type_hints(kind, include_extras=True)
    return {each.name: _key(hints[each.name]) for each in fields(kind) if each.repr}


def _key(hint: Any) -> Key:
    """Key of a field's type, as `Annotated[PerJoint, Ge(0)]`."""
    leaves = [*_leaves(hint)]
    known: dict[str, Any] = {
        "whole": int in leaves,
        "members": "word" if hint is str else "",
    }
    for leaf in leaves:
        match leaf:
            case Each():
                known["members"] = leaf.members
            case Sample():
                known["sample"] = leaf.what
            case Ge():
                known["least"] = leaf.ge
            case Le():
                known["most"] = leaf.le
            case Gt():
                known["positive"] = True
    return Key(**known)


def _leaves(hint: Any) -> Iterator[Any]:
    """Types and marks that a type is made of."""
    inner = get_args(hint)
    for each in inner:
        yield from _leaves(each)
    if not inner:
        yield hint


class KindTable(Value, ABC):
    """One value of a kind."""

    kind: ClassVar[str]
    """Its name in files."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def __post_init__(self) -> None:
        for name, wanted in self.known_keys().items():
            value = getattr(self, name)
            if value is not None or self._default(name) is not None:
                object.__setattr__(
                    self, name, wanted.checked(value, f"{self.kind}: {name}")
                )

    def __eq__(self, other: object) -> bool:
        """Values are the same if their tables are, whatever they are installed on."""
        return isinstance(other, KindTable) and self.table() == other.table()

    def __hash__(self) -> int:
        return hash(self.kind)

    def _default(self, name: str) -> Any:
        default = type(self).__dataclass_fields__[name].default
        return None if default is MISSING else default

    @classmethod
    def known_keys(cls) -> dict[str, Key]:
        """Keys of the table, besides `kind`."""
        return _keys(cls)

    def table(self) -> dict[str, Any]:
        """The value as a file says it, every default written out."""
        values = {name: _plain(getattr(self, name)) for name in self.known_keys()}
        return {"kind": self.kind} | {k: v for k, v in values.items() if v is not None}

    @property
    def by_joint(self) -> dict[str, Mapping[str, float]]:
        """The keys that are tables by joint name."""
        values = {name: getattr(self, name) for name in self.known_keys()}
        return {
            name: value for name, value in values.items() if isinstance(value, Mapping)
        }

    def of_joints(self, names: tuple[str, ...]) -> dict[str, Any]:
        """The keys that have one number a joint, in the joints' order: a number for all, or each.

        Raises:
            SettingsError: It names a joint that is not there, or not of all.
        """
        wanted = {
            k: key for k, key in self.known_keys().items() if key.members == "joints"
        }
        return {name: self._of_joints(name, key, names) for name, key in wanted.items()}

    def _of_joints(self, name: str, key: Key, names: tuple[str, ...]) -> Any:
        value = getattr(self, name)
        if isinstance(value, Mapping):
            for joint in value:
                if joint not in names:
                    raise SettingsError(
                        f"{self.kind}: {UnknownName('joint', joint, names)}"
                    )
            other = self._default(name) if key.positive else 0.0
            return tuple(value.get(joint, other) for joint in names)
        if isinstance(value, tuple) and len(value) != len(names):
            raise SettingsError(
                f"{self.kind}: {name} has {len(value)} numbers for {len(names)} joints "
                f"({', '.join(names)})"
            )
        return value


def each_joint(value: PerJoint) -> Array:
    """Numbers of joints: () or (n,)."""
    return np.asarray(value, dtype=float)


def _plain(value: Any) -> Any:
    """A value as TOML takes it."""
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return dict(value) if isinstance(value, Mapping) else value
