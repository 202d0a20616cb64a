"""All kinds of faults, a fault of its table in an experiment file, and all of them in words."""

from __future__ import annotations

from collections.abc import Mapping

from testbed.errors import SettingsError, UnknownName
from testbed.instruments import joints, plate, plate_clock
from testbed.instruments.fault import Fault, Place
from testbed.kind_table import in_words, of_table, rows

_DEVICES = (joints, plate, plate_clock)

KINDS: Mapping[str, type[Fault]] = {
    fault.kind: fault for device in _DEVICES for fault in device.FAULTS
}
"""Every fault that an experiment file can ask for, by kind."""


_TITLES = {"position": "Encoders", "torque": "Drives", "wrench": "The plate", "tare": "The tare"}


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
        raise SettingsError(f"{UnknownName('kind of fault', kind, KINDS)}; see `testbed faults`")
    return KINDS[kind]


def as_markdown() -> str:
    """The catalogue as the tables of a document: the places, then one a signal."""
    kinds = tuple(KINDS.values())
    lines = ["", "| place | " + " | ".join(_TITLES.values()) + " |"]
    lines += ["| --- " * (1 + len(_TITLES)) + "|"]
    for place in Place:
        here = [fault for fault in kinds if fault.place == place]
        cells = [", ".join(f"`{f.kind}`" for f in here if f.signal == s) for s in _TITLES]
        lines.append(f"| {place.name.lower()} | {' | '.join(cells)} |")
    for signal, title in _TITLES.items():
        own = [in_words(fault) for fault in kinds if fault.signal == signal]
        lines += ["", f"### {title}", "", *rows(own)]
    examples = "\n".join(f"    {in_words(fault).example}," for fault in kinds)
    lines += ["", "### All of them, as they may be written", ""]
    lines += ["```toml", "[measurement]", "fault = [", examples, "]", "```", ""]
    return "\n".join(lines)
