"""Mutants: small wrong changes of the project's own source.

A mutant is made from the syntax tree of a module and written as a change of its text, so
that all else stays as it is, comments and lines included. What says nothing to a program is
left alone: docstrings, annotations, messages of errors, imports, blocks for type checkers.
"""

from __future__ import annotations

import ast
import builtins
import copy
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

Change: TypeAlias = tuple[str, ast.AST, ast.AST]
"""Kind, the node that is replaced, and what replaces it."""

Value: TypeAlias = bool | int | float | str

_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}
_ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
}
_SWAPPED = (ast.MatMult, ast.BitOr)
"""Operators whose operands change places."""

_KEYED = ("get", "pop", "startswith", "endswith", "removeprefix", "removesuffix", "getattr")
"""Functions whose strings are looked up, not read by people."""

_SPOKEN = ("help", "metavar", "strict", "maxsize")
"""Arguments that are texts, zip's `strict`, which is an assertion, and how much a cache keeps."""


@dataclass(frozen=True)
class Mutant:
    """One change of one module.

    Attributes:
        module: Its path below the root, such as "testbed/arrays.py".
        function: Dotted name within the module; "" for the module itself.
        line: First line of the change.
        often: As its statement's.
        kind: What is done, such as "comparison".
        start: First byte that is replaced.
        end: First byte after it.
        text: What is put there.
        original: The lines as they are.
        mutated: The lines as they become.
    """

    module: str
    function: str
    line: int
    often: tuple[int, int]
    kind: str
    start: int
    end: int
    text: str
    original: str
    mutated: str

    def __str__(self) -> str:
        """For people."""
        return f"{self.module}:{self.line} {self.kind}: {self.original}  ->  {self.mutated}"

    @property
    def room(self) -> str:
        """The folder of testbed/ that it is in."""
        return room_of(self.module)

    @property
    def key(self) -> str:
        """Tells the change from all others of the module."""
        said = f"{self.module} {self.function} {self.start} {self.end} {self.text}"
        return hashlib.sha256(said.encode()).hexdigest()[:12]

    def applied(self, source: bytes) -> bytes:
        """The module with the change in it."""
        return source[: self.start] + self.text.encode() + source[self.end :]


@dataclass(frozen=True)
class Statement:
    """A statement and the ways to change it.

    Attributes:
        node: The statement.
        function: Dotted name of the function or class it stands in.
        often: Lines of which a test that runs it executes one; none for what runs once, when
            the module is imported, and for what is kept from its first run.
        changes: Kind, what is replaced, and by what.
    """

    node: ast.stmt
    function: str
    often: range
    changes: tuple[Change, ...]


def room_of(module: str) -> str:
    """The folder of testbed/ that a module is in; "base" if in none."""
    parts = Path(module).parts
    return parts[1] if len(parts) > 2 else "base"


class Module:
    """A module, its statements, and how a change of its tree is written as a change of text."""

    def __init__(self, root: Path, path: Path) -> None:
        self.name = path.relative_to(root).as_posix()
        self.source = path.read_bytes()
        self._tree = ast.parse(self.source)
        self._lines = [0]
        for line in self.source.splitlines(keepends=True):
            self._lines.append(self._lines[-1] + len(line))
        body = [] if self.name == "testbed/__init__.py" else self._tree.body
        found = _statements(body, "", runs=False)
        self.statements = [each for each in found if each.changes]

    def mutant(self, statement: Statement, change: Change) -> Mutant:
        """A change, written."""
        kind, node, new = change
        start, end = self._span(node)
        wanted = ast.dump(copy.deepcopy(self._tree, {id(node): new}))
        plain = ast.unparse(new)
        for text in (plain, f"({plain})"):
            whole = self.source[:start] + text.encode() + self.source[end:]
            if _means(whole, wanted):
                break
        else:
            raise AssertionError(f"{self.name}: a change of {ast.unparse(node)} cannot be written")
        first = self.source.rfind(b"\n", 0, start) + 1
        last = self.source.find(b"\n", end)
        return Mutant(
            module=self.name,
            function=statement.function,
            line=self.source.count(b"\n", 0, start) + 1,
            often=(statement.often.start, statement.often.stop),
            kind=kind,
            start=start,
            end=end,
            text=text,
            original=_joined(self.source[first:last].decode()),
            mutated=_joined(whole[first : last + len(whole) - len(self.source)].decode()),
        )

    def _span(self, node: ast.AST) -> tuple[int, int]:
        assert isinstance(node, (ast.expr, ast.stmt))
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        first, last = self._lines[node.lineno - 1], self._lines[node.end_lineno - 1]
        return first + node.col_offset, last + node.end_col_offset


def _means(source: bytes, wanted: str) -> bool:
    try:
        return ast.dump(ast.parse(source)) == wanted
    except SyntaxError:
        return False


def _joined(text: str) -> str:
    return " ".join(text.split())


def _statements(body: list[ast.stmt], function: str, runs: bool) -> Iterator[Statement]:
    """All statements below, each with the changes of what it holds itself."""
    for node in body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        inside, deeper, often = function, runs, _head(node) if runs else range(0)
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            inside = f"{function}.{node.name}".lstrip(".")
            cached = any("cache" in ast.unparse(each) for each in node.decorator_list)
            deeper = isinstance(node, ast.FunctionDef) and not cached
            if deeper and not runs:  # defaults are seen where the function runs
                often = range(node.lineno, (node.end_lineno or node.lineno) + 1)
        yield Statement(node, function, often, tuple(_changes(node)))
        for name in ("body", "orelse", "finalbody"):
            yield from _statements(getattr(node, name, []), inside, deeper)
        for handler in getattr(node, "handlers", []):
            yield from _statements(handler.body, inside, deeper)


def _head(node: ast.stmt) -> range:
    """The lines of a statement without those of statements in it."""
    inner = getattr(node, "body", [])
    last = inner[0].lineno - 1 if inner else node.end_lineno
    return range(node.lineno, max(node.lineno, last or 0) + 1)


def _changes(statement: ast.stmt) -> Iterator[Change]:
    if isinstance(statement, (ast.Import, ast.ImportFrom)) or _is_docstring(statement):
        return
    if _may_go(statement):
        yield "deletion", statement, ast.Pass()
    if isinstance(statement, ast.Raise) or _is_for_types(statement):
        return
    if isinstance(statement, (ast.If, ast.While)):
        yield from _forced(statement.test, loops=isinstance(statement, ast.While))
        if isinstance(statement, ast.If):
            yield "not added", statement.test, ast.UnaryOp(ast.Not(), statement.test)
    if isinstance(statement, ast.Return) and statement.value is not None:
        yield from _reordered(statement.value)
    if isinstance(statement, ast.AugAssign) and type(statement.op) in _ARITHMETIC:
        other = _ARITHMETIC[type(statement.op)]()
        yield "arithmetic", statement, _like(statement, op=other)
    for node, parent, text in _own(statement):
        for kind, old, new in _of_expression(node, parent):
            if ast.dump(old) == ast.dump(new):
                continue  # both operands are the same
            if text is None:
                yield kind, old, new
            else:  # within an f-string, nodes do not know their places
                yield kind, text, copy.deepcopy(text, {id(old): new})


def _own(statement: ast.stmt) -> Iterator[tuple[ast.expr, ast.AST, ast.JoinedStr | None]]:
    """The expressions that a statement holds itself, with what holds each, and its f-string."""
    skipped = {"annotation", "returns", "body", "orelse", "finalbody", "handlers", "ctx"}
    waiting: list[tuple[ast.AST, ast.JoinedStr | None]] = [(statement, None)]
    while waiting:
        parent, text = waiting.pop()
        if isinstance(parent, ast.JoinedStr) and text is None:
            text = parent
        for name, value in ast.iter_fields(parent):
            if name in skipped and (isinstance(parent, (ast.stmt, ast.arg)) or name == "ctx"):
                continue
            if isinstance(parent, ast.keyword) and parent.arg in _SPOKEN:
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.expr):
                    yield child, parent, text
                if isinstance(child, ast.AST) and not _is_for_types(child):
                    waiting.append((child, text))


def _of_expression(node: ast.expr, parent: ast.AST) -> Iterator[Change]:
    match node:
        case ast.Compare() | ast.BinOp() | ast.UnaryOp() | ast.BoolOp():
            yield from _of_operator(node)
        case ast.IfExp():
            yield from _forced(node.test)
        case ast.ListComp() | ast.SetComp() | ast.GeneratorExp() | ast.DictComp():
            for test in (test for loop in node.generators for test in loop.ifs):
                yield from _forced(test)
        case ast.Subscript(slice=ast.Slice()):
            yield from _shifted(node)
        case ast.Constant():
            for value in _others(node.value, parent):
                yield "constant", node, _constant(value)
        case _:
            pass


def _of_operator(node: ast.Compare | ast.BinOp | ast.UnaryOp | ast.BoolOp) -> Iterator[Change]:
    match node:
        case ast.Compare():
            for k, op in enumerate(node.ops):
                for other in _COMPARISONS[type(op)]:
                    ops = [*node.ops[:k], other(), *node.ops[k + 1 :]]
                    yield "comparison", node, _like(node, ops=ops)
        case ast.BinOp() if type(node.op) in _ARITHMETIC:
            yield "arithmetic", node, _like(node, op=_ARITHMETIC[type(node.op)]())
        case ast.BinOp() if isinstance(node.op, _SWAPPED) and not _is_flag(node.right):
            yield "arithmetic", node, _like(node, left=node.right, right=node.left)
        case ast.UnaryOp(op=ast.USub()) | ast.UnaryOp(op=ast.Not()):
            yield "sign or not dropped", node, node.operand
        case ast.BoolOp():
            swapped = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            yield "and, or", node, _like(node, op=swapped)
        case _:
            pass


def _is_flag(node: ast.expr) -> bool:
    """Whether it looks like one of several bits or types: their order does not matter."""
    if isinstance(node, ast.Constant) and node.value is None:
        return True
    if isinstance(node, ast.Name):
        return node.id[0].isupper() or isinstance(getattr(builtins, node.id, None), type)
    return isinstance(node, ast.Attribute) or (
        isinstance(node, ast.Call) and ast.unparse(node.func) == "int"
    )


def _forced(test: ast.expr, loops: bool = False) -> Iterator[Change]:
    for value in (False,) if loops else (False, True):  # a loop for ever tells nothing
        yield "condition forced", test, ast.Constant(value)


def _reordered(value: ast.expr) -> Iterator[Change]:
    if isinstance(value, ast.Tuple) and len(value.elts) > 1:
        first, second, *rest = value.elts
        if not _same(first, second):
            yield "order of results", value, _like(value, elts=[second, first, *rest])
    if isinstance(value, ast.Call) and len(value.args) > 1:
        first, second, *rest = value.args
        if not (_same(first, second) or ast.Starred in map(type, (first, second))):
            yield "order of arguments", value, _like(value, args=[second, first, *rest])


def _same(first: ast.expr, second: ast.expr) -> bool:
    """Whether it does not matter which of the two comes first."""
    return ast.dump(first) == ast.dump(second)


def _shifted(node: ast.Subscript) -> Iterator[Change]:
    """A slice that begins or ends one later or earlier."""
    part = node.slice
    assert isinstance(part, ast.Slice)
    one = ast.Constant(1)
    if part.lower is None:
        yield "slice", node, _like(node, slice=_like(part, lower=one))
    elif not isinstance(part.lower, ast.Constant):
        later = ast.BinOp(part.lower, ast.Add(), one)
        yield "slice", node, _like(node, slice=_like(part, lower=later))
    if part.upper is None:
        end = ast.UnaryOp(ast.USub(), one)
        yield "slice", node, _like(node, slice=_like(part, upper=end))
    elif not isinstance(part.upper, ast.Constant):
        earlier = ast.BinOp(part.upper, ast.Sub(), one)
        yield "slice", node, _like(node, slice=_like(part, upper=earlier))


def _constant(value: Value) -> ast.expr:
    if isinstance(value, (int, float)) and not isinstance(value, bool) and value < 0:
        return ast.UnaryOp(ast.USub(), ast.Constant(-value))
    return ast.Constant(value)


def _others(value: object, parent: ast.AST) -> tuple[Value, ...]:
    """What a constant may be mistaken for."""
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, int) and value and _is_size(parent):
        return value + 1, value - 1
    if isinstance(value, int):
        return tuple(dict.fromkeys((value + 1, value - 1, -value) if value else (1,)))
    if isinstance(value, float):
        return (-value, 2 * value, value / 2) if value else (1.0,)
    if isinstance(value, str) and _is_looked_up(value, parent):
        return (value + "_",) if value else ("_",)
    return ()


def _is_size(parent: ast.AST) -> bool:
    """Whether it is a size of `reshape`, which takes any number below zero for "what is left"."""
    return isinstance(parent, ast.Call) and ast.unparse(parent.func).endswith(".reshape")


def _is_looked_up(text: str, parent: ast.AST) -> bool:
    """Whether a string is a key or a choice: a word that a program, not a person, reads."""
    if any(letter.isspace() for letter in text):
        return False
    if isinstance(parent, ast.Call):
        called = parent.func
        name = called.attr if isinstance(called, ast.Attribute) else ast.unparse(called)
        return name in _KEYED
    holders = (ast.Dict, ast.Subscript, ast.Compare, ast.Tuple, ast.List, ast.Set)
    return isinstance(parent, (*holders, ast.arguments, ast.Return, ast.IfExp))


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _may_go(node: ast.stmt) -> bool:
    """Whether a program goes on without this statement, if only wrongly."""
    if isinstance(node, (ast.Expr, ast.AugAssign, ast.Raise, ast.Continue, ast.Break)):
        return True
    return isinstance(node, ast.Assign) and any(
        isinstance(target, (ast.Attribute, ast.Subscript)) for target in node.targets
    )


def _is_for_types(node: ast.AST) -> bool:
    """Whether only type checkers read it: an alias of `Literal`, a type variable, a cast."""
    if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None:
        return _is_for_types(node.value)
    if isinstance(node, ast.Subscript):
        return ast.unparse(node.value) in {"Literal", "Callable"}
    return isinstance(node, ast.Call) and ast.unparse(node.func) in {"TypeVar", "cast"}


def _like(node: ast.AST, **changed: object) -> ast.AST:
    """A copy with some fields changed."""
    fields = dict(ast.iter_fields(node)) | changed
    return type(node)(**fields)
