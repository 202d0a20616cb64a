"""A value that a file says as a table: its kind, and keys with defaults and bounds.

A kind is one frozen dataclass: `kind` as a class variable, a field a key. Faults of instruments
and effects in the plant are such values.

A single number where a kind has one for every joint holds for all; a list gives each its own; in a
table by joint name those left out have zero, or the default where zero makes no sense.
"""

from __future__ import annotations

from abc import ABC
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields
from typing import Any, ClassVar, TypeAlias, TypeVar

import numpy as np

from testbed.arrays import Array
from testbed.errors import SettingsError, UnknownName
from testbed.keys import Key

PerJoint: TypeAlias = float | tuple[float, ...] | Mapping[str, float]
"""One for all joints, one a joint in their order, or by name."""


class KindTable(ABC):
    """One value of a kind."""

    kind: ClassVar[str]
    """Its name in files."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def __post_init__(self) -> None:
        for name, wanted in self.known_keys().items():
            value = getattr(self, name)
            if value is not None or _default(self, name) is not None:
                object.__setattr__(self, name, wanted.checked(value, f"{self.kind}: {name}"))

    def __eq__(self, other: object) -> bool:
        """Values are the same if their tables are, whatever they are installed on."""
        return isinstance(other, KindTable) and self.table() == other.table()

    def __hash__(self) -> int:
        return hash(self.kind)

    @classmethod
    def known_keys(cls) -> dict[str, Key]:
        """What may be said in the table, besides `kind`."""
        return {f.name: f.metadata["key"] for f in fields(cls) if "key" in f.metadata}

    def table(self) -> dict[str, Any]:
        """The value as a file says it, every default written out."""
        values = {name: _plain(getattr(self, name)) for name in self.known_keys()}
        return {"kind": self.kind} | {k: v for k, v in values.items() if v is not None}

    @property
    def by_joint(self) -> dict[str, Mapping[str, float]]:
        """The keys that are tables by joint name."""
        values = {name: getattr(self, name) for name in self.known_keys()}
        return {name: value for name, value in values.items() if isinstance(value, Mapping)}

    def of_joints(self, names: tuple[str, ...]) -> dict[str, Any]:
        """The keys that have one number a joint, in the joints' order: a number for all, or each.

        Args:
            names: Joint names.

        Raises:
            SettingsError: It speaks of a joint that is not there, or not of all.
        """
        wanted = {k: key for k, key in self.known_keys().items() if key.members == "joints"}
        return {name: self._of_joints(name, key, names) for name, key in wanted.items()}

    def _of_joints(self, name: str, key: Key, names: tuple[str, ...]) -> Any:
        value = getattr(self, name)
        if isinstance(value, Mapping):
            for joint in value:
                if joint not in names:
                    raise SettingsError(f"{self.kind}: {UnknownName('joint', joint, names)}")
            other = _default(self, name) if key.positive else 0.0
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


Some = TypeVar("Some", bound=KindTable)


def of_table(table: object, what: str, example: str, named: Callable[[str], type[Some]]) -> Some:
    """A value of its table.

    Args:
        table: `kind` and the kind's own keys.
        what: What all kinds are, for the error.
        example: One of the kinds, likewise.
        named: The kind of a name.

    Raises:
        SettingsError: The kind or a key is not known, or a value is none that it takes.
    """
    if not isinstance(table, Mapping) or not isinstance(table.get("kind"), str):
        raise SettingsError(f'{what} is a table with its kind, as {{ kind = "{example}" }}')
    kind = named(table["kind"])
    values = {name: value for name, value in table.items() if name != "kind"}
    known = kind.known_keys()
    for name in values:
        if name not in known:
            raise SettingsError(str(UnknownName(f"key of {kind.kind}", str(name), known)))
    return kind(**values)


class AsTable:
    """How pydantic reads a value of a file's table, and writes it back.

    Attributes:
        read: Makes the value of its table.
    """

    def __init__(self, read: Callable[[object], KindTable]) -> None:
        self.read = read

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> dict[str, Any]:
        """A schema of pydantic-core, which is a plain dictionary."""
        del source, handler
        return {
            "type": "function-plain",
            "function": {"type": "no-info", "function": self.read},
            "serialization": {"type": "function-plain", "function": KindTable.table},
        }


def _default(value: KindTable, name: str) -> Any:
    default = type(value).__dataclass_fields__[name].default
    return None if default is MISSING else default


def _plain(value: Any) -> Any:
    """A value as TOML takes it."""
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return dict(value) if isinstance(value, Mapping) else value
