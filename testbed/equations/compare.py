"""Somebody's listing, read back and compared with the robot's own equations, term by term.

Reads the notation of `languages.text`, the paper's: sums of products of names and numbers,
brackets, NAME = ... on one line or several. Python's own parser makes a syntax tree of a right-hand
side, and the few kinds of nodes above are read from it; nothing of it is ever executed.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial, reduce

from numpy.typing import ArrayLike

from testbed.core.base.errors import ExpressionError, UnknownName
from testbed.core.robot.tree import Tree
from testbed.equations.equations import FORMS, KINDS, Form, Listing, equations, expander
from testbed.equations.expression import (
    MAX_TERMS,
    Budget,
    Expression,
    Term,
    collect,
    cosine,
    expression,
    number,
    of,
    sine,
    substitute,
)
from testbed.equations.polynomial import LARGEST as HIGHEST_DEGREE
from testbed.equations.robot import Robot, draw

_ILLEGIBLE = re.compile(r"[^\w\s.+\-*/^()].{,9}", re.ASCII)
_SUMMAND_END = re.compile(
    r"((?<![\w.])(?>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_]\w*)|\))\s*(?=[+-])", re.ASCII
)
_WAVE = re.compile(r"[SC](?:\d+|(?:_m?\d+)+)", re.ASCII)
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)

HIGHEST = 20
"""Largest exponent."""
TERM_LENGTH = 40
"""Characters that a term of a listing takes, amply."""


def compare_equations(
    tree: Tree,
    text: str,
    form: Form = "full",
    gravity: ArrayLike | None = None,
    zeros: bool | Sequence[str] = False,
    max_terms: int = MAX_TERMS,
) -> dict[str, Expression]:
    """What a listing says too much or too little, equation by equation.

    Args:
        tree: The robot.
        text: The listing, in the notation of [FRS96]; see `read_listing`. Names on the
            left that are none of the robot's equations are definitions for those below.
        form: Whose parameters it is in: "full" or "reduced" ("recursive" is the same).
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
        zeros: Barycentric parameters known to be zero, as in `equations`.
        max_terms: How many terms the robot's own equations, the listing, and their
            difference may have, each.

    Returns:
        The listing's equation less the robot's own, by name; zero where they are equal,
        whatever way they are written.

    Raises:
        ExpressionError: The listing cannot be read, or there are more terms.
        UnknownName: It holds a name that stands for nothing, or an equation that is none of
            the robot's and no definition for others.
    """
    if form not in FORMS:
        raise UnknownName("form", form, FORMS)
    literal: Form = "full" if form == "full" else "reduced"
    kinds = _kinds([name for _, name, _ in _statements(text, max_terms)])
    listing = equations(tree, kinds, literal, gravity, zeros, max_terms=max_terms)
    robot = draw(tree, tree.gravity_or(gravity))
    steps = [step for each in listing.equations for step in each.program.steps]
    meanings = dict(steps)
    ours = {}
    for name, value in steps:
        meanings[name] = ours[name.name] = substitute(value, meanings.get)
    for label, value in listing.definitions:
        ours[label] = ours[label.replace("mbar", "mm")] = value
    names = _names(listing, robot)
    read = read_listing(text, names, max_terms)
    if not read:
        raise ExpressionError("the listing holds no equation")
    _check_definitions(text, [name for name in read if name not in ours], names, ours)
    found = [name for name in read if name in ours]
    expand = expander(robot, Budget(max_terms))
    return {name: expand(read[name] - ours[name]) for name in found}


def _kinds(names: Sequence[str]) -> list[str]:
    """The kinds of equations that a listing's names belong to."""
    comparable = [kind for kind in KINDS.values() if not kind.is_regressor]
    found = [
        kind.name
        for kind in comparable
        if any(re.fullmatch(kind.results, name, re.ASCII) for name in names)
    ]
    return found or [kind.name for kind in comparable]


def _check_definitions(
    text: str, others: Sequence[str], names: Mapping[str, Expression], ours: Iterable[str]
) -> None:
    """What is none of the robot's equations must be new, and of use below."""
    times = Counter(re.findall(r"\w+", text, re.ASCII))
    for name in others:
        if name in names:
            raise ExpressionError(f"'{name}' is the robot's own and not for a listing to define")
        if times[name] < 2:
            raise UnknownName("equation", name, ours)


def _names(listing: Listing, robot: Robot) -> dict[str, Expression]:
    """What the names of a listing may stand for."""
    symbols = [*robot.q, *robot.qd, *robot.qdd, *(of(constant) for constant in robot.values)]
    names = {repr(value): value for value in symbols}
    for each in listing.equations:
        for parameter in each.parameters:
            if parameter.symbol is not None:
                names[parameter.symbol.name] = of(parameter.symbol)
    for _, value in listing.definitions:
        names |= {factor.name: of(factor) for factors, _ in value.terms for factor in factors}
    names |= {name.replace("mbar", "mm"): value for name, value in names.items()}
    return names


def _value(node: ast.AST, names: Mapping[str, Expression], budget: Budget) -> Expression:
    """Expression of a syntax tree; tuples stand for sums."""
    match node:
        case ast.Tuple(elts=summands):
            terms: list[Term] = []
            for summand in summands:
                added = _value(summand, names, budget).terms
                budget.write(max(1, len(added)))
                terms += added
            return collect(terms)
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
            found = _value(operand, names, budget)
            return -found if isinstance(sign, ast.USub) else found
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(exponent))):
            if not 1 <= exponent <= HIGHEST:
                raise ExpressionError(f"an exponent is a number from 1 to {HIGHEST}")
            base = _value(left, names, budget)
            return reduce(partial(_multiplied, budget), [base] * exponent)
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as operator, right=right):
            combined = _multiplied if isinstance(operator, ast.Mult) else _divided
            return combined(budget, _value(left, names, budget), _value(right, names, budget))
    return _leaf(node, names)


def _leaf(node: ast.AST, names: Mapping[str, Expression]) -> Expression:
    match node:
        case ast.Constant(value=int(value) | float(value)) if not isinstance(value, bool):
            return number(value)
        case ast.Name(id=name) if name in names:
            return names[name]
        case ast.Name(id=name) if _WAVE.fullmatch(name):
            return _wave(name, names)
        case ast.Name(id=name):
            raise UnknownName("name", name, names)
    raise ExpressionError(f"'{ast.unparse(node)[:40]}' is no sum, product or power")


def _divided(budget: Budget, a: Expression, b: Expression) -> Expression:
    if len(b.terms) != 1 or b.terms[0][0]:
        raise ExpressionError("a listing divides by numbers only, and not by zero")
    budget.multiply(1 + len(a.terms))
    return a / b.terms[0][1]


def _multiplied(budget: Budget, a: Expression, b: Expression) -> Expression:
    budget.multiply(len(a.terms) + len(b.terms))  # a sum becomes a bracket
    product = expression(a * b)
    if any(len(factors) > HIGHEST_DEGREE for factors, _ in product.terms):
        raise ExpressionError(f"a product of more than {HIGHEST_DEGREE} factors")
    return product


def _right_side(text: str, names: Mapping[str, Expression], budget: Budget) -> Expression:
    """Right-hand side of an equation; a sum of any length becomes a tuple."""
    culprit = _ILLEGIBLE.search(text)
    if culprit:
        raise ExpressionError(f"'{culprit[0]}' cannot be read")
    summands = _SUMMAND_END.sub(r"\1,", text.replace("^", "**")).strip()
    try:
        return _value(ast.parse(f"{summands},", mode="eval").body, names, budget)
    except SyntaxError as error:
        raise ExpressionError(f"'{text.strip()[:40]}' cannot be read: {error.msg}") from None
    except (RecursionError, MemoryError):
        raise ExpressionError("factors, signs or brackets are nested too deeply") from None


def read_listing(
    text: str, names: Mapping[str, Expression], max_terms: int = MAX_TERMS
) -> dict[str, Expression]:
    """The equations of a listing, in its order; later ones may refer to earlier ones.

    Args:
        text: NAME = expression; lines that begin with a blank or a sign continue the one
            before, those that begin with * or # are comments.
        names: What names stand for; a listing may say what they are, and does not change it.
        max_terms: How many terms it may have, those that its names stand for included.

    Raises:
        ExpressionError: It cannot be read, or has more terms.
        UnknownName: It holds a name that stands for nothing.
    """
    known = dict(names)
    found: dict[str, Expression] = {}
    budget = Budget(max_terms)
    for line, name, right in _statements(text, max_terms):
        if not right.strip() or not _NAME.fullmatch(name):
            raise ExpressionError(f"line {line}: NAME = expression, found '{name[:40]}'")
        if name in found:
            raise ExpressionError(f"line {line}: {name} is defined twice")
        try:
            found[name] = _right_side(right, known, budget)
        except ExpressionError as error:
            raise ExpressionError(f"line {line}: {error}") from None
        except UnknownName as error:
            raise UnknownName(f"name on line {line}", error.name, error.known) from None
        known.setdefault(name, found[name])
    return found


def _wave(name: str, names: Mapping[str, Expression]) -> Expression:
    """S223 as sin(2 q2 + q3), C_12_m3 as cos(q12 - q3).

    Raises:
        ExpressionError: It is of too many joints.
        UnknownName: There is no such joint.
    """
    label = name[1:]
    parts = label.strip("_").split("_") if "_" in label else list(label)
    if len(parts) > HIGHEST_DEGREE:
        raise ExpressionError(f"an angle of more than {HIGHEST_DEGREE} joints")
    terms = []
    for part in parts:
        angle = names.get(f"q{part.removeprefix('m')}")
        if angle is None:
            raise UnknownName("name", name, names)
        terms.append((angle.terms[0][0], -1 if part[0] == "m" else 1))
    angle = collect(terms)
    if not angle:
        return number(0 if name[0] == "S" else 1)
    return sine(angle) if name[0] == "S" else cosine(angle)


def _statements(text: str, max_terms: int) -> Iterator[tuple[int, str, str]]:
    """Number of the first line, name and right-hand side of every equation."""
    most = TERM_LENGTH * max_terms
    if len(text) > most:
        raise ExpressionError(
            f"a listing of more than {most} characters; --max-terms N (max_terms=N) allows more"
        )
    statements: list[tuple[int, list[str]]] = []
    for line, words in enumerate(text.splitlines(), start=1):
        if words.startswith(("*", "#", "[")) or not words.strip():
            continue
        if statements and words[0] in " \t+-":
            statements[-1][1].append(words)
        else:
            statements.append((line, [words]))
    for line, lines in statements:
        name, _, right = "".join(lines).partition("=")
        yield line, name.strip(), right
