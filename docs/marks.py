"""What a command has written into a page, between two marks."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

END = "<!-- end of what is written -->\n"


def mark_of(module: str, of: str = "") -> str:
    """The mark after which a command writes.

    Args:
        module: Of the project's documents, as "docs.instruments".
        of: What is written there, where a page has several such places.
    """
    return f"<!-- written by python -m {module}{f': {of}' if of else ''} -->\n"


def written(text: str, module: str, words: Callable[[str], str]) -> str:
    """A page with all that a command writes in its places.

    Args:
        text: The page.
        module: The command's.
        words: What stands in a place, by what its mark states.
    """
    mark = re.escape(mark_of(module)).replace(r"\ \-\->", r"(?:: ([^\n]*?))?\ \-\->")
    place = re.compile(f"({mark})(?:.*?)({re.escape(END)})", re.DOTALL)
    return place.sub(lambda found: found[1] + words(found[2] or "") + found[3], text)


def write(
    document: Path, module: str, words: Callable[[str], str], template: Path | None = None
) -> None:
    """Write a page's places anew.

    Args:
        document: The page.
        module: The command's.
        words: What stands in a place, by what its mark states.
        template: The page without what is written, where the page itself is not committed.
    """
    document.write_text(written((template or document).read_text(), module, words))


def table(head: str, rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table.

    Args:
        head: Titles, with bars between them.
        rows: Cells.
    """
    columns = head.split("|")
    lines = [f"| {' | '.join(c.strip() for c in columns)} |", f"|{' --- |' * len(columns)}"]
    return lines + [f"| {' | '.join(cell(each) for each in row)} |" for row in rows]


def cell(text: str) -> str:
    """What stands in a cell: its bars are none of the table's."""
    parts = re.split(r"(`[^`]*`)", text)
    parts[::2] = [part.replace("|", "&#124;") for part in parts[::2]]
    parts[1::2] = [re.sub(r" ?\| ?", " or ", code) for code in parts[1::2]]
    return "".join(parts)


def prose(text: str) -> str:
    """Words of a docstring as Markdown shows them: stars and underlines stay what they are.

    Args:
        text: Of the docstring.
    """
    parts = re.split(r"(`[^`]*`)", text)
    parts[::2] = [re.sub(r"([*_<\[\]~])", r"\\\1", part) for part in parts[::2]]
    return "".join(parts)
