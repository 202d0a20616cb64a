"""Descriptions of sensor errors and effects, for the documentation and `testbed list`."""

from __future__ import annotations

import inspect
import json
import re
from dataclasses import dataclass
from typing import Any

from testbed.sensors.kind_table import KindTable


@dataclass(frozen=True)
class KindDescription:
    """Description of a kind of sensor error or effect, from its docstring.

    Attributes:
        kind: Name of the kind.
        summary: Description in one sentence.
        details: Formulas and further details; may be "".
        source: Source of the default size.
        keys: Name, default value, and meaning with unit of each key.
        example: Inline table for an experiment file.
    """

    kind: str
    summary: str
    details: str
    source: str
    keys: tuple[tuple[str, str, str], ...]
    example: str


def describe_kind(kind: type[KindTable]) -> KindDescription:
    """Description of a kind, from its docstring and its default values.

    The docstring consists of the summary as the first paragraph, details, the paragraph "Source",
    and the meanings of the keys under "Attributes:".

    Args:
        kind: Class of the kind; all keys must have defaults.
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
        (k, _toml_text(table.get(k)), _single_line(meanings[k]))
        for k in kind.known_keys()
    )
    example = ", ".join(
        f"{name} = {_toml_text(value)}" for name, value in table.items()
    )
    return KindDescription(
        kind.kind,
        _single_line(summary),
        _single_line(details),
        _single_line(source),
        keys,
        f"{{ {example} }}",
    )


def kind_table_lines(entries: list[KindDescription]) -> list[str]:
    """Lines of a Markdown table of kinds: name, description, keys and source of the size."""
    lines = ["| kind | what it is | keys: default, meaning | source of the size |"]
    lines += ["| --- | --- | --- | --- |"]
    for entry in entries:
        keys = "<br>".join(
            f"`{k}`: {default}, {meaning}" for k, default, meaning in entry.keys
        )
        description = " ".join(filter(None, (entry.summary, entry.details)))
        cells = (f"`{entry.kind}`", description, keys, entry.source)
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return lines


def _single_line(text: str) -> str:
    """Text on one line, with single spaces."""
    return " ".join(text.split())


def _toml_text(value: Any) -> str:
    """Default value as TOML text; numbers have six significant digits."""
    if value is None:
        return "none"
    return json.dumps(value) if isinstance(value, str) else f"{value:.6g}"
