"""Every number that the program decides by, from its source: `python -m docs.constants`."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from itertools import groupby, pairwise
from pathlib import Path

from docs.marks import prose, table, write

DOCUMENT = Path(__file__).with_suffix(".md")
TEMPLATE = DOCUMENT.parent / "templates" / DOCUMENT.name
MODULE = "docs.constants"
SOURCE = Path(__file__).parents[1] / "testbed"
LONGEST = 100
"""Characters of a value that is shown; what is longer is a table, no number."""


def as_markdown(of: str) -> str:
    """All constants, room by room.

    Args:
        of: Nothing: there is one place.
    """
    lines: list[str] = []
    for room, found in groupby(constants(SOURCE), key=lambda each: each[0]):
        rows = [(f"`{name}`", f"`{value}`", prose(said)) for _, name, value, said in found]
        lines += ["", f"### {room}", "", *table("name | value | meaning", rows)]
    return "\n".join([*lines, "", ""])


def constants(source: Path) -> Iterator[tuple[str, str, str, str]]:
    """Room, name, value and meaning of every module's public numbers that have a docstring.

    Args:
        source: Folder of the package.
    """
    places = [path.relative_to(source).with_suffix("") for path in source.rglob("*.py")]
    for place in sorted(places, key=lambda place: (len(place.parts) == 1, place.parts)):
        room = place.parts[0] if len(place.parts) > 1 else "all rooms"
        text = (source / place).with_suffix(".py").read_text()
        for node, after in pairwise(ast.parse(text).body):
            if isinstance(node, ast.Assign) and (said := _docstring(after)):
                name = ast.unparse(node.targets[0]).strip("()")
                value = " ".join((ast.get_source_segment(text, node.value) or "").split())
                if name.isupper() and name[0] != "_" and _is_number(node.value, value):
                    yield room, f"{'.'.join(place.parts[1:]) or place}.{name}", value, said


def _docstring(node: ast.stmt) -> str:
    """What stands below a constant, in one line; "" if nothing does."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return " ".join(str(node.value.value).split())
    return ""


def _is_number(value: ast.expr, text: str) -> bool:
    """Whether a value is numbers and what is computed of them."""
    numbers = (each.value for each in ast.walk(value) if isinstance(each, ast.Constant))
    return len(text) <= LONGEST and any(type(each) in (int, float) for each in numbers)


if __name__ == "__main__":
    write(DOCUMENT, MODULE, as_markdown, TEMPLATE)
