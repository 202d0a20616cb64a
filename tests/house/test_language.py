"""First lines of docstrings and names, as far as a machine can judge them."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.helpers.paths import ROOT

MAX_WORDS = 15
"""Words of a first line; what stands in brackets, quotes or backticks counts as one."""


WORDS = {
    rule: frozenset(words.split())
    for rule, words in tomllib.loads((ROOT / "tests/house/language.toml").read_text()).items()
}
"""Words by the rule that forbids them."""

CODE = sorted((ROOT / "testbed").rglob("*.py"))

Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


class Definition(NamedTuple):
    """Module, class, function or method of a file."""

    node: Documented
    name: str
    nested: bool

    @property
    def is_function(self) -> bool:
        return isinstance(self.node, ast.FunctionDef | ast.AsyncFunctionDef)

    @property
    def is_special(self) -> bool:
        """True for what Python's own protocols name, and for overloads and setters."""
        decorators = [ast.unparse(each) for each in getattr(self.node, "decorator_list", [])]
        marks = (".setter", "overload")
        return self.name.startswith("__") or any(each.endswith(marks) for each in decorators)


def definitions(node: ast.AST, nested: bool = False) -> Iterator[Definition]:
    """Definitions within a module, class or function, itself first."""
    if isinstance(node, Documented):
        yield Definition(node, getattr(node, "name", "module"), nested)
        nested = nested or not isinstance(node, ast.Module | ast.ClassDef)
    for child in ast.iter_child_nodes(node):
        yield from definitions(child, nested)


def faults_of_line(line: str) -> Iterator[str]:
    """Broken rules of a docstring's first line."""
    plain = re.sub(r"\([^)]*\)|\[[^\]]*\]|`[^`]*`|\"[^\"]*\"", " X ", line)
    words = [word.lower() for word in re.findall(r"[\w'-]+", plain)]
    if not line.endswith((".", ":", ")")):
        yield "no full stop"
    if len(words) > MAX_WORDS:
        yield f"{len(words)} words"
    if words and words[0] in WORDS["openings"]:
        yield f'opens with "{words[0]}"'
    yield from (f'"{word}"' for word in words if word in WORDS["pronouns"] | WORDS["persons"])
    yield from (f'early "{word}"' for word in words[:4] if word in WORDS["early_pronouns"])


def faults(definition: Definition) -> Iterator[str]:
    """Broken rules of a definition."""
    if definition.is_special:
        return
    node, document = definition.node, ast.get_docstring(definition.node)
    if definition.is_function:
        if definition.name.strip("_") in WORDS["names"]:
            yield "its name"
        names = [each.arg for each in ast.walk(node) if isinstance(each, ast.arg)]
        stores = [each for each in ast.walk(node) if isinstance(each, ast.Name)]
        names += [each.id for each in stores if isinstance(each.ctx, ast.Store)]
        yield from (f"variable `{name}`" for name in sorted(WORDS["variables"].intersection(names)))
    empty = isinstance(node, ast.Module) and not node.body
    if empty or (definition.nested and definition.is_function):
        return
    yield from faults_of_line(document.split("\n")[0]) if document else ["no docstring"]


@pytest.mark.parametrize("path", CODE, ids=lambda path: str(path.relative_to(ROOT)))
def test_docstrings_and_names_are_of_the_field(path: Path) -> None:
    """Nouns for values, imperative verbs for actions; docs/conventions.md has the words."""
    found = definitions(ast.parse(path.read_text()))
    broken = {(each.name, fault) for each in found for fault in faults(each)}
    assert broken == set(), path


def test_the_rules_refuse_riddles() -> None:
    """Samples of lines that readers did not understand."""
    for line in (
        "Theirs, (s, s).",
        "Of relative sigmas, of that kind.",
        "Whether what is said first is what should be; None where nothing is claimed.",
        "Empty ones, as wide as the joint's data ask for.",
    ):
        assert list(faults_of_line(line)), line
    assert list(faults_of_line("Covariance of the sensor errors, (s, s).")) == []
