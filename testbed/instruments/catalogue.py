"""What there is to say of every kind of fault, from the faults themselves."""

from __future__ import annotations

from collections.abc import Iterator

from testbed.instruments.fault import Place
from testbed.instruments.faults import KINDS, fault_named
from testbed.kind_words import Entry, in_words, rows


def catalogue() -> Iterator[Entry]:
    """All kinds, device by device, in the order in which devices list them."""
    return (in_words(fault) for fault in KINDS.values())


def entry_of(kind: str) -> Entry:
    """What there is to say of a kind.

    Args:
        kind: Its name.

    Raises:
        SettingsError: There is none.
    """
    return in_words(fault_named(kind))


def as_markdown() -> str:
    """The catalogue as the tables of a document: the places, then one a signal."""
    lines = ["", "| place | " + " | ".join(_TITLES.values()) + " |"]
    lines += ["| --- " * (1 + len(_TITLES)) + "|"]
    for place in Place:
        kinds = [f for f in KINDS.values() if f.place == place]
        cells = [", ".join(f"`{f.kind}`" for f in kinds if f.signal == s) for s in _TITLES]
        lines.append(f"| {place.name.lower()} | {' | '.join(cells)} |")
    for signal, title in _TITLES.items():
        own = [in_words(fault) for fault in KINDS.values() if fault.signal == signal]
        lines += ["", f"### {title}", "", *rows(own)]
    examples = "\n".join(f"    {entry.example}," for entry in catalogue())
    lines += ["", "### All of them, as they may be written", ""]
    lines += ["```toml", "[measurement]", "fault = [", examples, "]", "```", ""]
    return "\n".join(lines)


_TITLES = {
    "position": "Encoders",
    "torque": "Drives",
    "wrench": "The plate",
    "tare": "The tare",
}
