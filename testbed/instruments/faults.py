"""All kinds of faults, and a fault of the table that an experiment file has for it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from testbed.errors import SettingsError, UnknownName
from testbed.instruments import drives, encoders, plate, plate_clock, plate_noise, tare
from testbed.instruments.fault import Fault

_DEVICES = (encoders, drives, plate, plate_clock, plate_noise, tare)

KINDS: Mapping[str, type[Fault]] = {
    fault.kind: fault for device in _DEVICES for fault in device.FAULTS
}
"""Every fault that an experiment file can ask for, by kind."""


def fault_of(table: object) -> Fault:
    """A fault of its table.

    Args:
        table: `kind` and the kind's own keys; a fault is returned as it is.

    Raises:
        SettingsError: The kind or a key is not known, or a value is none that it takes.
    """
    if isinstance(table, Fault):
        return table
    if not isinstance(table, Mapping) or not isinstance(table.get("kind"), str):
        raise SettingsError('a fault is a table with its kind, as { kind = "plate_bias" }')
    fault = fault_named(table["kind"])
    values = {name: value for name, value in table.items() if name != "kind"}
    known = fault.known_keys()
    for name in values:
        if name not in known:
            raise SettingsError(str(UnknownName(f"key of {fault.kind}", str(name), known)))
    return fault(**values)


def fault_named(kind: str) -> type[Fault]:
    """The faults of a kind.

    Args:
        kind: Its name.

    Raises:
        SettingsError: There is none; says those of the same device, or all.
    """
    if kind not in KINDS:
        device = [known for known in KINDS if known.split("_")[0] == kind.split("_", maxsplit=1)[0]]
        said = UnknownName("kind of fault", kind, device or KINDS)
        raise SettingsError(f"{said}; `testbed faults` lists all")
    return KINDS[kind]


class AsTable:
    """How pydantic reads a fault of an experiment file's table, and writes it back."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> dict[str, Any]:
        """A schema of pydantic-core, which is a plain dictionary."""
        del source, handler
        return {
            "type": "function-plain",
            "function": {"type": "no-info", "function": fault_of},
            "serialization": {"type": "function-plain", "function": Fault.table},
        }
