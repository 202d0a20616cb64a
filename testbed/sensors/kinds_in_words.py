"""Descriptions of kinds, for tables of the documents and `testbed list`."""

from __future__ import annotations

import inspect
import json
import re
from dataclasses import dataclass
from typing import Any

from testbed.sensors.kind_table import KindTable


@dataclass(frozen=True)
class KindDescription:
    """Description of one kind, for tables of the documents and `testbed list`.

    Attributes:
        kind: Its name.
        summary: What it is, in a sentence.
        details: Formulas and what else is to be known; may be empty.
        source: Where the default size comes from.
        keys: (name, default, meaning with unit) of each key.
        example: A line of an experiment file.
    """

    kind: str
    summary: str
    details: str
    source: str
    keys: tuple[tuple[str, str, str], ...]
    example: str


def in_words(kind: type[KindTable]) -> KindDescription:
    """What there is to say of a kind.

    Args:
        kind: The kind; all its keys have defaults.
    """
    text = inspect.getdoc(kind) or ""
    body, _, attributes = text.partition("\n\nAttributes:\n")
    body, _, source = body.partition("\n\nSource ")
    summary, _, details = body.partition("\n\n")
    table = kind().table()
    meanings = dict(
        re.findall(r"^    (\w+): ((?:.|\n {8})*)", attributes, re.MULTILINE)
    )
    keys = tuple(
        (k, _toml(table.get(k)), _line(meanings[k])) for k in kind.known_keys()
    )
    example = ", ".join(f"{name} = {_toml(value)}" for name, value in table.items())
    return KindDescription(
        kind.kind,
        _line(summary),
        _line(details),
        _line(source),
        keys,
        f"{{ {example} }}",
    )


def rows(entries: list[KindDescription]) -> list[str]:
    """A table of a document: kind, what it is, its keys, the source of the size."""
    lines = ["| kind | what it is | keys: default, meaning | source of the size |"]
    lines += ["| --- | --- | --- | --- |"]
    for entry in entries:
        keys = "<br>".join(
            f"`{k}`: {default}, {said}" for k, default, said in entry.keys
        )
        what = " ".join(filter(None, (entry.summary, entry.details)))
        cells = (f"`{entry.kind}`", what, keys, entry.source)
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return lines


def _line(text: str) -> str:
    return " ".join(text.split())


def _toml(value: Any) -> str:
    """A default as TOML writes it; numbers in a few digits."""
    if value is None:
        return "none"
    return json.dumps(value) if isinstance(value, str) else f"{value:.6g}"
