"""Values of kinds from the tables of files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

from testbed.core.base.errors import SettingsError, UnknownName
from testbed.sensors.catalogue import simulated_errors
from testbed.sensors.kind_table import KindTable
from testbed.sensors.sensor_error import SensorError

Some = TypeVar("Some", bound=KindTable)


def of_table(table: object, what: str, kinds: Mapping[str, type[Some]]) -> Some:
    """Read a value of its table.

    Args:
        table: `kind` and the kind's own keys; a value is returned as it is.
        what: What all kinds are: "fault", "effect".
        kinds: All kinds, by name.

    Raises:
        SettingsError: The kind or a key is not known, or a value is none that it takes.
    """
    if isinstance(table, KindTable):
        return cast(Some, table)
    if not isinstance(table, Mapping) or not isinstance(table.get("kind"), str):
        example = next(iter(kinds))
        raise SettingsError(
            f'{what} is a table with its kind, as {{ kind = "{example}" }}'
        )
    kind = kind_named(table["kind"], what, kinds)
    values = {name: value for name, value in table.items() if name != "kind"}
    known = kind.known_keys()
    for name in values:
        if name not in known:
            raise SettingsError(
                str(UnknownName(f"key of {kind.kind}", str(name), known))
            )
    return kind(**values)


def kind_named(name: str, what: str, kinds: Mapping[str, type[Some]]) -> type[Some]:
    """The kind of a name.

    Raises:
        SettingsError: There is none.
    """
    if name not in kinds:
        unknown = UnknownName(f"kind of {what}", name, kinds)
        raise SettingsError(f"{unknown}; see `testbed {what}s`")
    return kinds[name]


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


def error_of(table: object) -> SensorError:
    """Sensor error of the table that an experiment file has.

    Args:
        table: `kind` and the kind's own keys; a sensor error is returned as it is.

    Raises:
        SettingsError: The kind or a key is not known, or a value is none that it takes.
    """
    return of_table(table, "fault", simulated_errors())
