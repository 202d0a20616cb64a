"""A mapping file as it is written: what it says of each key, and beside it why."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from testbed.errors import printable

LONGEST = 300
"""Characters of a note that quotes names of files and columns."""


@dataclass(frozen=True)
class Draft:
    """A mapping file as it is written.

    Attributes:
        tables: By dotted name, that of the keys without a table being empty: keys and values.
        notes: By table and key, what is said beside it.
        remarks: Lines of comment above a table, or in place of one that is not there.
    """

    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    notes: Mapping[tuple[str, str], str] = field(default_factory=dict)
    remarks: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def saying(self, table: str, key: str, value: Any, note: str = "") -> Draft:
        """The same with another value of a key, and another note beside it; None takes it out.

        Args:
            table: Its dotted name.
            key: Of the table.
            value: Number, text, list or table.
            note: One line; none if that is empty.
        """
        kept = {name: each for name, each in self.tables.get(table, {}).items() if name != key}
        keys = {**self.tables.get(table, {}), key: value} if value is not None else kept
        notes = {place: each for place, each in self.notes.items() if place != (table, key)}
        notes |= {(table, key): note} if note and value is not None else {}
        return replace(self, tables={**self.tables, table: keys}, notes=notes)

    def remarking(self, table: str, *lines: str) -> Draft:
        """The same with lines of comment above a table, or in place of one that is not there."""
        said = [*self.remarks.get(table, ()), *lines]
        tables = {**self.tables} if table in self.tables else {**self.tables, table: {}}
        return replace(self, tables=tables, remarks={**self.remarks, table: said})

    @property
    def content(self) -> dict[str, Any]:
        """As TOML would be read; a key that begins with # is a comment."""
        found: dict[str, Any] = {}
        for name, keys in self.tables.items():
            here = found
            for part in name.split(".") if name and keys else ():
                here = here.setdefault(part, {})
            here.update({key: value for key, value in keys.items() if key[0] != "#"})
        return found

    @property
    def text(self) -> str:
        """The file."""
        blocks = []
        for name, keys in self.tables.items():
            lines = [*self.remarks.get(name, ())] + [f"[{name}]"] * bool(name and keys)
            for key, value in keys.items():
                note = printable(self.notes.get((name, key), ""), LONGEST)
                lines.append(f"{key} = {in_toml(value)}" + f"  # {note}" * bool(note))
            blocks.append("\n".join(lines))
        return "\n\n".join(blocks) + "\n"


def in_toml(value: Any) -> str:
    """A value as TOML writes it.

    Args:
        value: Number, text, or a list or table of these.
    """
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {in_toml(each)}' for key, each in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(in_toml, value))}]"
    return f"{value:.15g}" if isinstance(value, float) else json.dumps(value, ensure_ascii=True)
