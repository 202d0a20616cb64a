"""The house stays within its budget: budget.toml has every figure, which may only go down."""

from __future__ import annotations

import ast
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from itertools import chain
from pathlib import Path
from typing import TypeVar

import pytest

from tests.helpers.blocks import PAGES
from tests.helpers.modules import MODULES, syntax
from tests.helpers.paths import ROOT

DOCS = ROOT / "docs"
BUDGET = tomllib.loads((Path(__file__).parent / "budget.toml").read_text())
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
DOCUMENTED = (ast.Module, ast.ClassDef, *FUNCTIONS)
MANY_LOCALS = 15
T = TypeVar("T")


def is_text(node: ast.AST) -> bool:
    """Whether a statement is a docstring or the text below a constant."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def counted(node: ast.AST) -> Iterator[ast.AST]:
    """Nodes of a syntax tree without docstrings, annotations and the three contexts of names."""
    if isinstance(node, ast.Load | ast.Store | ast.Del):
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns"):
            if isinstance(node, ast.AnnAssign):
                yield ast.Constant(None)
            continue
        children = value if isinstance(value, list) else [value]
        if name == "body" and isinstance(node, DOCUMENTED):
            children = [child for child in children if not is_text(child)] or [ast.Pass()]
        for child in children:
            if isinstance(child, ast.AST):
                yield from counted(child)


@cache
def size(module: str) -> int:
    """Number of counted nodes of a module."""
    return sum(1 for _ in counted(syntax(module)))


def code_lines(module: str) -> int:
    """Number of lines that are neither empty nor part of a docstring; comments count."""
    statements = (x for x in ast.walk(syntax(module)) if isinstance(x, ast.Expr) and is_text(x))
    without = {k for x in statements for k in range(x.lineno, (x.end_lineno or x.lineno) + 1)}
    lines = enumerate(MODULES[module].read_text("utf-8").splitlines(), 1)
    return sum(bool(line.strip()) and k not in without for k, line in lines)


def closure(start: T, successors: Mapping[T, Iterable[T]]) -> set[T]:
    """Everything that can be reached from a start, with the start."""
    reached, waiting = {start}, [start]
    while waiting:
        fresh = set(successors.get(waiting.pop(), ())) - reached
        reached |= fresh
        waiting.extend(fresh)
    return reached


@cache
def imports(module: str) -> dict[str, tuple[str, str | None]]:
    """Local names a module imports from the package: (module, None) or (module, name in it)."""
    names: dict[str, tuple[str, str | None]] = {}
    for node in ast.walk(syntax(module)):
        if isinstance(node, ast.ImportFrom) and node.module in MODULES:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                target = (full, None) if full in MODULES else (node.module, alias.name)
                names[alias.asname or alias.name] = target
    return names


def loaded(module: str) -> set[str]:
    """Modules that are loaded with a module, lazily or not."""
    return closure(module, {m: [other for other, _ in imports(m).values()] for m in MODULES})


@cache
def definitions() -> dict[tuple[str, str], ast.AST]:
    """Functions, classes and constants at the top of every module."""
    table: dict[tuple[str, str], ast.AST] = {}
    for module in MODULES:
        for node in syntax(module).body:
            if isinstance(node, (ast.ClassDef, *FUNCTIONS)):
                table[module, node.name] = node
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                table |= {(module, x.id): node for x in targets if isinstance(x, ast.Name)}
    return table


def meaning(module: str, name: str) -> tuple[str, str] | None:
    """Definition that a name of a module stands for, through any number of imports."""
    while (module, name) not in definitions():
        source, original = imports(module).get(name, (module, None))
        if original is None:
            return None
        module, name = source, original
    return module, name


def uses(module: str, node: ast.AST) -> Iterator[tuple[str, str]]:
    """Definitions that a definition names, also as attributes of an imported module."""
    for part in ast.walk(node):
        target = None
        if isinstance(part, ast.Name):
            target = meaning(module, part.id)
        elif isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name):
            source, original = imports(module).get(part.value.id, (module, ""))
            target = meaning(source, part.attr) if original is None else None
        if target:
            yield target


def reached(entry: str) -> int:
    """Number of definitions that a function (MODULE:NAME) can reach by name."""
    graph = {key: list(uses(key[0], node)) for key, node in definitions().items()}
    module, name = entry.split(":")
    return len(closure((module, name), graph))


def local_names(function: ast.AST) -> int:
    """Number of names that a function assigns."""
    names = (x for x in ast.walk(function) if isinstance(x, ast.Name))
    return len({x.id for x in names if isinstance(x.ctx, ast.Store)})


def within(name: str, figure: float, limit: float) -> None:
    assert figure <= limit, f"{name}: {figure:.5g}, at most {limit:g} (tests/house/budget.toml)"


def test_no_room_is_larger_than_its_budget() -> None:
    sizes: Counter[str] = Counter()
    for module in MODULES:
        sizes[module.split(".")[1] if module.count(".") else "testbed"] += size(module)
    limits = dict(BUDGET["kilonodes"])
    within("testbed/ in all [kilonodes]", sizes.total() / 1000, limits.pop("in_all"))
    rooms = {name for name in sizes if name not in ("testbed", "__main__")}
    assert rooms == set(limits), "every room has one line in budget.toml"
    for name, limit in limits.items():
        within(f"testbed/{name} [kilonodes]", sizes[name] / 1000, limit)


def test_lines_are_not_dense_and_functions_keep_few_names() -> None:
    shape = BUDGET["shape"]
    nodes, lines = sum(map(size, MODULES)), sum(map(code_lines, MODULES))
    within("nodes a line of code", nodes / lines, shape["nodes_a_line"])
    every = chain.from_iterable(ast.walk(syntax(module)) for module in MODULES)
    many = sum(local_names(f) > MANY_LOCALS for f in every if isinstance(f, FUNCTIONS))
    within(f"functions of more than {MANY_LOCALS} locals", many, shape["functions_of_many_locals"])
    classes = [key[1] for key, node in definitions().items() if isinstance(node, ast.ClassDef)]
    repeated = {n for n, k in Counter(classes).items() if k > 1 and not n.startswith("_")}
    within(f"public classes of one name {sorted(repeated)}", len(repeated), shape["names_twice"])


@pytest.mark.parametrize("entry", BUDGET["loaded"])
def test_one_verb_loads_little(entry: str) -> None:
    nodes = sum(map(size, loaded(entry.partition(":")[0])))
    within(f"loaded by {entry} [kilonodes]", nodes / 1000, BUDGET["loaded"][entry])


@pytest.mark.parametrize("entry", BUDGET["reached"])
def test_one_verb_reaches_few_definitions(entry: str) -> None:
    within(f"definitions reached by {entry}", reached(entry), BUDGET["reached"][entry])


def test_no_code_hides_in_text() -> None:
    """What is run stands as code, where the figures above see it."""
    for module in MODULES:
        for node in ast.walk(syntax(module)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("exec", "eval", "compile"), (module, node.lineno)


def test_tests_and_benchmarks_stay_short() -> None:
    for folder, limit in BUDGET["lines"].items():
        lines = sum(path.read_text().count("\n") for path in (ROOT / folder).rglob("*.py"))
        within(f"lines of {folder}/", lines, limit)


def test_documents_stay_short() -> None:
    limits = BUDGET["documents"]
    pages = {page.name: page.read_text().count("\n") for page in PAGES if page.parent == DOCS}
    within("pages of docs/", len(pages), limits["pages"])
    within("lines of docs/", sum(pages.values()), limits["lines"])
    within(f"lines of {max(pages, key=pages.__getitem__)}", max(pages.values()), limits["longest"])
    changes = (ROOT / "CHANGELOG.md").read_text().count("\n")
    within("lines of CHANGELOG.md", changes, limits["changes"])
