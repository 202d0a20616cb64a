"""Somebody's listing, read back and compared with the robot's own equations, term by term.

Reads the notation of `languages.text`, the paper's: sums of products of names and numbers,
brackets, NAME = ... on one line or several. Python's own parser makes a syntax tree of a right-hand
side, and a few kinds of nodes are read from it; nothing of it is ever executed.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from math import prod

from numpy.typing import ArrayLike

from testbed.core.base.errors import ExpressionError, UnknownName
from testbed.core.robot.tree import Tree
from testbed.equations.equations import KINDS, Form, Listing, equations, expander
from testbed.equations.expression import (
    MAX_TERMS,
    ZERO,
    Budget,
    Expression,
    Factor,
    Number,
    Term,
    collect,
    cosine,
    expression,
    factor,
    number,
    of,
    sine,
    substitute,
)
from testbed.equations.program import leaves
from testbed.equations.robot import SymbolicRobot, draw

_SUMMAND_END = re.compile(
    r"((?<![\w.])(?>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_]\w*)|\))\s*(?=[+-])",
    re.ASCII,
)
_WAVE = re.compile(r"[SC](?:\d+|(?:_m?\d+)+)", re.ASCII)
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)

MAX_EXPONENT = 20
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
    """Subtract a robot's own equations from those of a listing.

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
    kinds = _kinds([name for _, name, _ in _statements(text, max_terms)])
    literal: Form = "reduced" if form == "recursive" else form
    listing = equations(tree, kinds, literal, gravity, zeros, max_terms)
    robot = draw(tree, tree.gravity_or(gravity))
    ours = _own_equations(listing)
    names = _names(listing, robot)
    read = read_listing(text, names, max_terms)
    if not read:
        raise ExpressionError("the listing holds no equation")
    expand = expander(robot, Budget(max_terms))
    found = {}
    for name, value in read.items():
        if name in ours:
            found[name] = expand(value - ours[name])
        elif name in names:
            raise ExpressionError(
                f"'{name}' is the robot's own and not for a listing to define"
            )
        elif len(re.findall(rf"\b{name}\b", text)) < 2:
            raise UnknownName("equation", name, ours)
    return found


def _kinds(names: Sequence[str]) -> list[str]:
    """The kinds of equations that a listing's names belong to."""
    found = [
        kind.name
        for kind in KINDS.values()
        if any(re.fullmatch(kind.results, name, re.ASCII) for name in names)
        and not kind.is_regressor
    ]
    return found or ["joint-forces"]


def _own_equations(listing: Listing) -> dict[str, Expression]:
    """The robot's equations by name, those that refer to others written out."""
    meanings: dict[Factor, Expression] = {}
    for each in listing.equations:
        for name, value in each.program.steps:
            meanings[name] = substitute(value, meanings.get)
    ours = {name.name: value for name, value in meanings.items()}
    for label, value in listing.definitions:
        ours[label] = ours[label.replace("mbar", "mm")] = value
    return ours


def _names(listing: Listing, robot: SymbolicRobot) -> dict[str, Expression]:
    """What the names of a listing may stand for."""
    symbols = [*map(factor, [*robot.q, *robot.qd, *robot.qdd]), *robot.values]
    for each in listing.equations:
        symbols += [
            parameter.symbol for parameter in each.parameters if parameter.symbol
        ]
    for _, value in listing.definitions:
        symbols += leaves(value)
    names = {symbol.name: of(symbol) for symbol in symbols}
    return names | {name.replace("mbar", "mm"): value for name, value in names.items()}


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
            raise ExpressionError(
                f"line {line}: NAME = expression, found '{name[:40]}'"
            )
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


def _right_side(
    text: str, names: Mapping[str, Expression], budget: Budget
) -> Expression:
    """Right-hand side of an equation; a sum of any length becomes a tuple."""
    summands = _SUMMAND_END.sub(r"\1,", text.replace("^", "**")).strip()
    try:
        return _value(ast.parse(f"{summands},", mode="eval").body, names, budget)
    except SyntaxError as error:
        raise ExpressionError(
            f"'{text.strip()[:40]}' cannot be read: {error.msg}"
        ) from None
    except ZeroDivisionError:
        raise ExpressionError("a division by zero") from None
    except (RecursionError, MemoryError):
        raise ExpressionError(
            "factors, signs or brackets are nested too deeply"
        ) from None


def _value(
    node: ast.AST, names: Mapping[str, Expression], budget: Budget
) -> Expression:
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
            value = _value(operand, names, budget)
            return -value if isinstance(sign, ast.USub) else value
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            factors = [_value(left, names, budget), _value(right, names, budget)]
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            value = _value(left, names, budget)
            return value / _number(right)
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            exponent = _number(right)
            if exponent not in range(1, MAX_EXPONENT + 1):
                raise ExpressionError(
                    f"an exponent is a number from 1 to {MAX_EXPONENT}"
                )
            factors = [_value(left, names, budget)] * int(exponent)
        case ast.Name(id=name):
            return names[name] if name in names else _wave(name, names)
        case _:
            return number(_number(node))
    # a sum becomes a bracket
    budget.multiply(sum(len(factor.terms) for factor in factors))
    return expression(prod(factors))


def _number(node: ast.AST) -> Number:
    """Number of a leaf of a syntax tree."""
    match node:
        case ast.Constant(value=float() | int() as size) if not isinstance(size, bool):
            return size
    raise ExpressionError(
        f"'{ast.unparse(node)[:40]}' is no sum, product, power or number"
    )


def _wave(name: str, names: Mapping[str, Expression]) -> Expression:
    """S223 as sin(2 q2 + q3), C_12_m3 as cos(q12 - q3).

    Raises:
        UnknownName: There is no such joint.
    """
    if not _WAVE.fullmatch(name):
        raise UnknownName("name", name, names)
    label = name[1:]
    angle = ZERO
    for part in label.strip("_").split("_") if "_" in label else label:
        coordinate = names.get(f"q{part.removeprefix('m')}")
        if coordinate is None:
            raise UnknownName("name", name, names)
        angle = angle - coordinate if part[0] == "m" else angle + coordinate
    if name[0] == "S":
        return sine(angle) if angle else ZERO
    return cosine(angle) if angle else number(1)
