"""Every diagnostic with its causes and remedy, from the table: `python -m docs.messages`."""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path

from docs.marks import prose, table, write

DOCUMENT = Path(__file__).with_name("warnings.md")
TEMPLATE = DOCUMENT.parent / "templates" / DOCUMENT.name
MODULE = "docs.messages"


def as_markdown(of: str = "") -> str:
    """All diagnostics, group by group.

    Args:
        of: Nothing: there is one place.
    """
    del of
    from testbed.core.base.diagnostics import cause_phrase, message_table

    lines: list[str] = []
    for group, found in groupby(
        sorted(message_table().items()), key=lambda each: each[0].partition(".")[0]
    ):
        rows = [
            (
                f"`{code}` {message.level}",
                plain(message.text),
                "; ".join(map(cause_phrase, message.causes)),
                plain(message.remedy),
            )
            for code, message in found
        ]
        head = "code, level | what is the case | what may have caused it | what to do"
        lines += ["", f"## {group.capitalize()}", "", *table(head, rows)]
    return "\n".join([*lines, "", ""])


def plain(text: str) -> str:
    """A sentence with names for what differs from case to case."""
    parts = re.split(r"\{(\w+)[^}]*\}", text)
    parts[::2] = [prose(part) for part in parts[::2]]
    parts[1::2] = [f"*{name.replace('_', ' ')}*" for name in parts[1::2]]
    return "".join(parts)


if __name__ == "__main__":
    write(DOCUMENT, MODULE, as_markdown, TEMPLATE)
