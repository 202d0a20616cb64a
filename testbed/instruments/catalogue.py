"""What there is to say of every kind of fault, from the faults themselves.

Their docstrings hold a sentence, details, the source of the default size, and the keys.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from testbed.instruments.fault import Place
from testbed.instruments.faults import KINDS, fault_named


@dataclass(frozen=True)
class Entry:
    """One kind of fault in words.

    Attributes:
        kind: Its name.
        signal: What it spoils.
        summary: What it is, in a sentence.
        details: Formulas and what else is to be known; may be empty.
        source: Where the default size comes from.
        keys: (name, default, meaning with unit) of each key.
        example: A line of an experiment file.
    """

    kind: str
    signal: str
    summary: str
    details: str
    source: str
    keys: tuple[tuple[str, str, str], ...]
    example: str


def catalogue() -> Iterator[Entry]:
    """All kinds, device by device, in the order in which devices list them."""
    return (entry_of(kind) for kind in KINDS)


def entry_of(kind: str) -> Entry:
    """What there is to say of a kind.

    Args:
        kind: Its name.

    Raises:
        SettingsError: There is none.
    """
    fault = fault_named(kind)
    text = inspect.getdoc(fault) or ""
    body, _, attributes = text.partition("\n\nAttributes:\n")
    body, _, source = body.partition("\n\nSource ")
    summary, _, details = body.partition("\n\n")
    table = fault().table()
    meanings = dict(re.findall(r"^    (\w+): ((?:.|\n {8})*)", attributes, re.MULTILINE))
    keys = tuple((k, _toml(table.get(k)), _line(meanings[k])) for k in fault.known_keys())
    example = ", ".join(f"{name} = {_toml(value)}" for name, value in table.items())
    return Entry(
        fault.kind,
        fault.signal,
        _line(summary),
        _line(details),
        _line(source),
        keys,
        f"{{ {example} }}",
    )


def _line(text: str) -> str:
    return " ".join(text.split())


def _toml(value: Any) -> str:
    """A default as TOML writes it; numbers in a few digits."""
    if value is None:
        return "none"
    return json.dumps(value) if isinstance(value, str) else f"{value:.6g}"


def as_markdown() -> str:
    """The catalogue as the tables of a document: the places, then one a signal."""
    lines = ["", "| place | " + " | ".join(_TITLES.values()) + " |"]
    lines += ["| --- " * (1 + len(_TITLES)) + "|"]
    for place in Place:
        kinds = [f for f in KINDS.values() if f.place == place]
        cells = [", ".join(f"`{f.kind}`" for f in kinds if f.signal == s) for s in _TITLES]
        lines.append(f"| {place.name.lower()} | {' | '.join(cells)} |")
    signal = ""
    for entry in catalogue():
        if entry.signal != signal:
            signal = entry.signal
            lines += ["", f"### {_TITLES[signal]}", ""]
            lines += ["| kind | what it is | keys: default, meaning | source of the size |"]
            lines += ["| --- | --- | --- | --- |"]
        keys = "<br>".join(f"`{k}`: {default}, {said}" for k, default, said in entry.keys)
        what = " ".join(filter(None, (entry.summary, entry.details)))
        row = (f"`{entry.kind}`", what, keys, entry.source)
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in row)} |")
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
