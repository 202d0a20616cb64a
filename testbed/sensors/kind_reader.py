"""Construction of sensor errors and effects from tables in files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

from testbed.core.base.errors import SettingsError, UnknownName
from testbed.sensors.catalogue import simulated_errors
from testbed.sensors.kind_table import KindTable
from testbed.sensors.sensor_error import SensorError

KindT = TypeVar("KindT", bound=KindTable)


def value_from_table(
    table: object, what: str, kinds: Mapping[str, type[KindT]]
) -> KindT:
    """Build a value, such as a sensor error or an effect, from its table.

    Args:
        table: Table with `kind` and the keys of this kind; a `KindTable` is returned unchanged.
        what: Noun used in messages for all kinds: "fault" or "effect".
        kinds: Classes, keyed by kind.

    Raises:
        SettingsError: The kind or a key is unknown, or a value is not allowed.
    """
    if isinstance(table, KindTable):
        return cast(KindT, table)
    if not isinstance(table, Mapping) or not isinstance(table.get("kind"), str):
        example = next(iter(kinds))
        raise SettingsError(
            f'{what} is a table with its kind, as {{ kind = "{example}" }}'
        )
    kind = kind_by_name(table["kind"], what, kinds)
    values = {name: value for name, value in table.items() if name != "kind"}
    known = kind.known_keys()
    for name in values:
        if name not in known:
            raise SettingsError(
                str(UnknownName(f"key of {kind.kind}", str(name), known))
            )
    return kind(**values)


def kind_by_name(name: str, what: str, kinds: Mapping[str, type[KindT]]) -> type[KindT]:
    """Class of the kind with a given name.

    Args:
        name: Name of the kind.
        what: Noun used in messages for all kinds: "fault" or "effect".
        kinds: Classes, keyed by kind.

    Raises:
        SettingsError: The kind is unknown.
    """
    if name not in kinds:
        unknown = UnknownName(f"kind of {what}", name, kinds)
        raise SettingsError(f"{unknown}; see `testbed {what}s`")
    return kinds[name]


class TableField:
    """Pydantic annotation of a field that is read from and written as a table.

    Attributes:
        read: Function that builds the value from its table.
    """

    def __init__(self, read: Callable[[object], KindTable]) -> None:
        self.read = read

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> dict[str, Any]:
        """Schema of pydantic-core, a plain dictionary."""
        del source, handler
        return {
            "type": "function-plain",
            "function": {"type": "no-info", "function": self.read},
            "serialization": {"type": "function-plain", "function": KindTable.table},
        }


def sensor_error_from_table(table: object) -> SensorError:
    """Build a sensor error from its table in an experiment file.

    Args:
        table: Table with `kind` and the keys of this kind; a sensor error is returned unchanged.

    Raises:
        SettingsError: The kind or a key is unknown, or a value is not allowed.
    """
    return value_from_table(table, "fault", simulated_errors())
