"""All kinds of faults, a fault of its table in an experiment file, and all of them in words."""

from __future__ import annotations

from collections.abc import Mapping

from testbed.core.base.errors import SettingsError, UnknownName
from testbed.lab.instruments import joints, plate, plate_clock
from testbed.lab.instruments.fault import Fault
from testbed.lab.kind_table import of_table

_DEVICES = (joints, plate, plate_clock)

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
    return of_table(table, "a fault", "plate_bias", fault_named)


def fault_named(kind: str) -> type[Fault]:
    """The faults of a kind.

    Raises:
        SettingsError: There is none.
    """
    if kind not in KINDS:
        raise SettingsError(f"{UnknownName('kind of fault', kind, KINDS)}; see `testbed list`")
    return KINDS[kind]
