"""Every kind of warning has an entry in docs/warnings.md, and every entry is of a warning."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from tests.helpers.paths import ROOT

DOTS = "…"
ROOMS = ("robot", "parameters", "recordings", "identification", "sanity", "experiment")
SHORT = 26
"""Letters of parts of a sentence."""
NO_WARNINGS = {
    "_accuracy", "_causes", "_cures", "_fit", "_flaws", "_found", "_head", "_instrument",
    "_listed", "_measured", "_parameters", "_robot", "_signal", "equal_zeros", "missing",
    "provenance", "table_of", "validation_lines",
}  # fmt: skip
"""Functions that return sentences of another kind: of errors, summaries, files to start from."""


def template(node: ast.expr) -> str:
    """A sentence with dots for what differs."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        parts = [v.value if isinstance(v, ast.Constant) else DOTS for v in node.values]
        return "".join(str(part) for part in parts)
    return ""


def said_by(function: ast.FunctionDef) -> Iterator[str]:
    """Sentences that a function makes: findings, and lines that it yields, adds or returns."""
    makes = ast.unparse(function.returns) if function.returns else ""
    lines = re.search(r"(list|tuple|Iterator|Sequence)\[str", makes) is not None
    for node in ast.walk(function):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Finding":
            yield f"{template(node.args[0]) or DOTS} {template(node.args[1])}"
        elif lines and isinstance(node, ast.Yield) and node.value is not None:
            yield template(node.value)
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "append":
            if "warnings" in ast.unparse(node.func):
                yield template(node.args[0])
        elif lines and isinstance(node, ast.Return) and node.value is not None:
            yield from (template(n) for n in ast.walk(node.value) if isinstance(n, ast.JoinedStr))


def kinds() -> dict[str, str]:
    """Sentence of every kind, by where it is made."""
    found = {}
    for room in ROOMS:
        for path in sorted((ROOT / "testbed" / room).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.FunctionDef) and node.name not in NO_WARNINGS:
                    for k, said in enumerate(said_by(node)):
                        if len(said) > SHORT:
                            found[f"{path.name}-{node.name}-{k}"] = " ".join(said.split())
    return found


def entries() -> list[str]:
    """First cells of the page's tables."""
    rows = re.findall(r"^\| (.*?) \|", (ROOT / "docs/warnings.md").read_text(), re.MULTILINE)
    return [row for row in rows if row not in ("warning", "---")]


def holds(entry: str, said: str) -> bool:
    """Whether an entry is of a sentence: its parts stand there in order, anything between."""
    place = 0
    for part in entry.split(DOTS):
        place = said.find(part.strip(), place)
        if place < 0:
            return False
        place += len(part.strip())
    return True


def sentences() -> list[str]:
    """All that the source could say."""
    found = []
    for path in (ROOT / "testbed").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant | ast.JoinedStr):
                found.append(" ".join(template(node).split()))
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Finding":
                found.append(f"{template(node.args[0]) or DOTS} {template(node.args[1])}")
    return found


@pytest.mark.parametrize("said", [pytest.param(s, id=where) for where, s in kinds().items()])
def test_every_kind_of_warning_has_its_cause_and_cure(said: str) -> None:
    assert any(holds(entry, said) for entry in entries()), f"docs/warnings.md: {said}"


@pytest.mark.slow
def test_no_entry_is_of_a_warning_that_is_not_made() -> None:
    known = sentences()
    for entry in entries():
        assert any(holds(entry, said) for said in known), entry


def test_every_entry_has_cause_and_cure() -> None:
    rows = re.findall(r"^\| (.*) \|$", (ROOT / "docs/warnings.md").read_text(), re.MULTILINE)
    assert len(rows) > 40
    for row in rows:
        assert len([cell for cell in row.split(" | ") if cell.strip()]) == 3, row
