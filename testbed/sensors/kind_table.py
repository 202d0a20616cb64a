"""Base class of values configured by a table with a kind and bounded keys.

Each kind is a frozen dataclass with the class variable `kind` and one field per key. Sensor errors
and effects in the plant are defined in this way. The docstring of the class describes the kind: a
summary, details, the source of the default size, and the keys.

For a key with one number per joint, a single number applies to all joints, and a list gives one
number per joint. In a table keyed by joint name, omitted joints have zero, or the default value if
zero is not allowed.
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

MAX_MAGNITUDE = 1e9
"""Largest allowed magnitude of a number; its inverse is the smallest allowed positive number."""


@dataclass(frozen=True)
class PerMember:
    """Annotation of a key's type: a common value or one value per member.

    Attributes:
        members: "joints", "axes", "channels" or "matrix".
    """

    members: str


@dataclass(frozen=True)
class RandomDefault:
    """Annotation of a key's type: sign or phase drawn at random if not given.

    Attributes:
        what: "sign", drawn if a single number is given, or "phase", drawn if the value is omitted.
    """

    what: str


RANDOM_SIGN, RANDOM_PHASE = RandomDefault("sign"), RandomDefault("phase")

PerJoint: TypeAlias = Annotated[
    float | tuple[float, ...] | Mapping[str, float], PerMember("joints")
]
"""One number for all joints, a list in joint order, or a table keyed by joint name."""
PerAxis: TypeAlias = Annotated[float | tuple[float, ...], PerMember("axes")]
"""One number for x, y and z, or three numbers."""
PerChannel: TypeAlias = Annotated[float | tuple[float, ...], PerMember("channels")]
"""One number for all channels of the plate, or six numbers: Fx, Fy, Fz, Mx, My, Mz."""
Matrix: TypeAlias = Annotated[tuple[tuple[float, ...], ...], PerMember("matrix")]
"""Matrix (6, 6), as six rows."""

MEMBER_COUNTS = {"axes": 3, "channels": 6}
"""Lengths of lists that do not depend on the number of joints."""

_LISTS = {
    "axes": ", or a list of three (x, y, z)",
    "channels": ", or a list of six (Fx, Fy, Fz, Mx, My, Mz)",
    "joints": ", a list of one a joint, or a table by joint name",
}


@dataclass(frozen=True)
class Key:
    """Type, bounds and random default of a key in the table of a kind.

    Attributes:
        members: Members for which values may be given: "joints", "axes" or "channels"; "matrix" for
            a (6, 6) matrix, "word" for a word instead of a number, "" for a single number.
        sample: Random default: "sign" of a single number, "phase" of an omitted value, "" for none.
        least: Smallest allowed value.
        most: Largest allowed value.
        positive: True if zero is not allowed.
        whole: True if only integers are allowed.
    """

    members: str = ""
    sample: str = ""
    least: float = -MAX_MAGNITUDE
    most: float = MAX_MAGNITUDE
    positive: bool = False
    whole: bool = False

    def validated_value(self, value: Any, label: str) -> Any:
        """Validate a value of the key, and convert it to floats, tuples or dictionaries.

        Args:
            value: Value from Python or TOML.
            label: Name of the key in the message.

        Raises:
            SettingsError: The value is not allowed.
        """
        try:
            return self._converted_value(value)
        except (TypeError, ValueError, OverflowError):
            text = repr(value)
            text = text if len(text) <= 60 else f"{text[:60]}..."
            raise SettingsError(
                f"{label} is {self._description()}, found {text}"
            ) from None

    def _converted_value(self, value: Any) -> Any:
        """Convert a value to a float, integer, word, tuple, or dictionary keyed by joint name.

        Raises:
            TypeError, ValueError, OverflowError: The value is not allowed.
        """
        if self.members == "word":
            if not isinstance(value, str):
                raise TypeError
            return value
        if self.members == "matrix":
            rows = tuple(tuple(self._number(item) for item in row) for row in value)
            if [len(row) for row in rows] != [6] * 6:
                raise ValueError
            return rows
        if isinstance(value, Mapping) and self.members == "joints":
            return {str(joint): self._number(item) for joint, item in value.items()}
        if isinstance(value, list | tuple) and self.members:
            if len(value) != MEMBER_COUNTS.get(self.members, len(value)) or not value:
                raise ValueError
            return tuple(self._number(item) for item in value)
        return self._number(value)

    def _number(self, value: Any) -> float | int:
        """Convert a value to a number within the bounds.

        Raises:
            TypeError, ValueError: The value is not a number, or is not allowed.
        """
        if isinstance(value, bool | str | bytes):
            raise TypeError
        number = float(value)
        least = 1 / MAX_MAGNITUDE if self.positive else self.least
        if not least <= number <= self.most or (self.whole and number != int(value)):
            raise ValueError
        return int(value) if self.whole else number

    def _description(self) -> str:
        """Description of the allowed values, for messages."""
        if self.members == "word":
            return "a name"
        if self.members == "matrix":
            return "six lists of six numbers"
        number = "positive " * self.positive + "whole " * self.whole + "number"
        bounds = []
        if self.least > -MAX_MAGNITUDE:
            bounds.append(f"at least {self.least:g}")
        if self.most < MAX_MAGNITUDE:
            bounds.append(f"at most {self.most:g}")
        return f"a {number} {' and '.join(bounds)}".strip() + _LISTS.get(
            self.members, ""
        )


@cache
def _keys_of_kind(kind: type) -> dict[str, Key]:
    """Keys of a kind, from the types of its fields, except fields with `repr=False`."""
    hints = get_type_hints(kind, include_extras=True)
    return {
        field.name: _key_of_type(hints[field.name])
        for field in fields(kind)
        if field.repr
    }


def _key_of_type(hint: Any) -> Key:
    """Key that corresponds to the type of a field, such as `Annotated[PerJoint, Ge(0)]`."""
    leaves = [*_type_leaves(hint)]
    properties: dict[str, Any] = {
        "whole": int in leaves,
        "members": "word" if hint is str else "",
    }
    for leaf in leaves:
        match leaf:
            case PerMember():
                properties["members"] = leaf.members
            case RandomDefault():
                properties["sample"] = leaf.what
            case Ge():
                properties["least"] = leaf.ge
            case Le():
                properties["most"] = leaf.le
            case Gt():
                properties["positive"] = True
    return Key(**properties)


def _type_leaves(hint: Any) -> Iterator[Any]:
    """Types and annotations of which a type is composed."""
    arguments = get_args(hint)
    for argument in arguments:
        yield from _type_leaves(argument)
    if not arguments:
        yield hint


class KindTable(Value, ABC):
    """Base class of values that are configured by a table with a kind."""

    kind: ClassVar[str]
    """Name of the kind in files."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def __post_init__(self) -> None:
        for name, key in self.known_keys().items():
            value = getattr(self, name)
            if value is not None or self._default_value(name) is not None:
                object.__setattr__(
                    self, name, key.validated_value(value, f"{self.kind}: {name}")
                )

    def __eq__(self, other: object) -> bool:
        """Test whether the tables are equal; values determined by robot or plate are ignored."""
        return isinstance(other, KindTable) and self.table() == other.table()

    def __hash__(self) -> int:
        return hash(self.kind)

    def _default_value(self, name: str) -> Any:
        """Default value of a key; None if the key has no default."""
        default = type(self).__dataclass_fields__[name].default
        return None if default is MISSING else default

    @classmethod
    def known_keys(cls) -> dict[str, Key]:
        """Keys of the table, keyed by name, without `kind`."""
        return _keys_of_kind(cls)

    def table(self) -> dict[str, Any]:
        """Table that represents the value in a file, including all defaults."""
        values = {name: _toml_value(getattr(self, name)) for name in self.known_keys()}
        return {"kind": self.kind} | {k: v for k, v in values.items() if v is not None}

    @property
    def by_joint(self) -> dict[str, Mapping[str, float]]:
        """Values that are given by joint name, as one mapping per key."""
        values = {name: getattr(self, name) for name in self.known_keys()}
        return {
            name: value for name, value in values.items() if isinstance(value, Mapping)
        }

    def joint_values(self, names: tuple[str, ...]) -> dict[str, Any]:
        """Values of per-joint keys in joint order; a single number is kept.

        The result is keyed by the name of the key. Joints omitted in a table keyed by joint name
        have zero, or the key's default if zero is not allowed.

        Args:
            names: Joint names.

        Raises:
            SettingsError: A joint is unknown, or a list has another number of values.
        """
        joint_keys = {
            k: key for k, key in self.known_keys().items() if key.members == "joints"
        }
        return {
            name: self._joint_value(name, key, names)
            for name, key in joint_keys.items()
        }

    def _joint_value(self, name: str, key: Key, names: tuple[str, ...]) -> Any:
        """Value of a per-joint key in joint order; a single number is kept.

        Joints omitted in a table keyed by joint name have zero, or the key's default if zero is not
        allowed.

        Args:
            name: Name of the key.
            key: The key.
            names: Joint names.

        Raises:
            SettingsError: A joint is unknown, or a list has another number of values.
        """
        value = getattr(self, name)
        if isinstance(value, Mapping):
            for joint in value:
                if joint not in names:
                    raise SettingsError(
                        f"{self.kind}: {UnknownName('joint', joint, names)}"
                    )
            omitted_value = self._default_value(name) if key.positive else 0.0
            return tuple(value.get(joint, omitted_value) for joint in names)
        if isinstance(value, tuple) and len(value) != len(names):
            raise SettingsError(
                f"{self.kind}: {name} has {len(value)} numbers for {len(names)} joints "
                f"({', '.join(names)})"
            )
        return value


def joint_array(value: PerJoint) -> Array:
    """Values of a per-joint key as an array, () or (n,)."""
    return np.asarray(value, dtype=float)


def _toml_value(value: Any) -> Any:
    """Convert a value to lists and dictionaries, for TOML."""
    if isinstance(value, tuple):
        return [_toml_value(item) for item in value]
    return dict(value) if isinstance(value, Mapping) else value
