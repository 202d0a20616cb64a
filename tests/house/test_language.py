"""First lines of docstrings and names, as far as a machine can judge them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.helpers.paths import ROOT

MAX_WORDS = 15
"""Words of a first line; what stands in brackets, quotes or backticks counts as one."""

OPENINGS = frozenset(
    """what of whether which how where who whom when that it its they their theirs he all both one
    ones those these this each every same another such only as by for from in with without nothing
    none nobody to than if like rather so and or but no not at on once two three more most less
    else beside between after before until while there here""".split()
)
"""First words of relative clauses and fragments; a noun or an imperative verb comes first."""

PRONOUNS = frozenset("ones theirs those they them".split())
EARLY_PRONOUNS = frozenset("it its their itself".split())
"""Pronouns that have no noun yet among the first four words."""

PERSONS = frozenset(
    """say says said saying tell tells told telling nobody somebody anybody everybody whoever
    whatever whichever person people knows thinks wants wanted believes speaks asks asked answers
    stranger judge wish wishes thing things stuff look looks looked feels felt sees seen""".split()
)
"""Words for what only people do, and for nothing in particular."""

NAMES = frozenset(
    """about accepted across added after again alike allowed along alone apart around at asked
    become begin bent beside best better between beyond carried carries changed chosen counted cut
    cuts drawn each ended enough even every expecting far felt few follows found four fresh further
    given has here holds is keep keeps kept large late left like likely lone look looked looks made
    meant more most moved moves near never none odd of on one only others over own piled placed plain
    plus pulled put refused remarking rest said same say saying seen settled shown six slow some
    sticks stands stuck swallowed taken there three together told tried turned two under unseen used
    wanted widened with_ within without worse worst wrong""".split()
)
"""Names of functions that name no value and no action."""

VARIABLES = frozenset("found said kept shown felt made given every fresh further far told".split())
"""Names of variables that do not name their value."""

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
    if words and words[0] in OPENINGS:
        yield f'opens with "{words[0]}"'
    yield from (f'"{word}"' for word in words if word in PRONOUNS | PERSONS)
    yield from (f'early "{word}"' for word in words[:4] if word in EARLY_PRONOUNS)


def faults(definition: Definition) -> Iterator[str]:
    """Broken rules of a definition."""
    if definition.is_special:
        return
    node, document = definition.node, ast.get_docstring(definition.node)
    if definition.is_function:
        if definition.name.strip("_") in NAMES:
            yield "its name"
        names = [each.arg for each in ast.walk(node) if isinstance(each, ast.arg)]
        stores = [each for each in ast.walk(node) if isinstance(each, ast.Name)]
        names += [each.id for each in stores if isinstance(each.ctx, ast.Store)]
        yield from (f"variable `{name}`" for name in sorted(VARIABLES.intersection(names)))
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
