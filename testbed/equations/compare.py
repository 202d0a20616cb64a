"""Term-by-term comparison of a listing of equations with the equations derived from a robot.

The notation is that of [FRS96], as written by `write_paper_notation`: NAME = sum of products of
names, numbers and brackets, on one or several lines. Python's parser makes a syntax tree of a
right-hand side, and a few kinds of its nodes are converted; no part of it is executed.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from math import prod

from numpy.typing import ArrayLike

from testbed.core.base.errors import ExpressionError, UnknownName
from testbed.core.robot.tree import Tree
from testbed.equations.equations import KINDS, Form, Listing, equations, make_expander
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
    factor_expression,
    number,
    sine,
    single_factor,
    substitute,
)
from testbed.equations.program import leaf_factors
from testbed.equations.robot import SymbolicRobot, symbolic_robot

_SUMMAND_END = re.compile(
    r"((?<![\w.])(?>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_]\w*)|\))\s*(?=[+-])",
    re.ASCII,
)
_SINE_OR_COSINE_NAME = re.compile(r"[SC](?:\d+|(?:_m?\d+)+)", re.ASCII)
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*", re.ASCII)

MAX_EXPONENT = 20
CHARACTERS_PER_TERM = 40
"""Characters per term; with `max_terms` the limit for the length of a listing."""


def compare_equations(
    tree: Tree,
    text: str,
    form: Form = "full",
    gravity: ArrayLike | None = None,
    zeros: bool | Sequence[str] = False,
    max_terms: int = MAX_TERMS,
) -> dict[str, Expression]:
    """Subtract the equations derived from a robot from the equations of a listing.

    Args:
        tree: The robot.
        text: The listing, in the notation of [FRS96]; see `read_listing`. A left-hand side that is
            not an equation of the robot defines an intermediate variable for the lines below.
        form: Parameters of the listing: "full" for barycentric, "reduced" or "recursive" for
            minimal parameters.
        gravity: Gravity in the bedplate frame, (3,) [m/s^2]; None for the gravity of the model
            file.
        zeros: Barycentric parameters known to be zero, as in `equations`.
        max_terms: Largest number of terms, separately for the robot's equations, the listing and
            the differences.

    Returns:
        Differences `listed - derived` of the equations, keyed by name; zero where both are
        mathematically equal. Intermediate variables are left out.

    Raises:
        ExpressionError: The listing cannot be read, has no equation or defines a symbol of the
            robot, or there are more terms than `max_terms`.
        UnknownName: The listing contains an undefined name, or a left-hand side that is neither an
            equation of the robot nor used in another line.
    """
    kinds = _listed_kinds([name for _, name, _ in _statements(text, max_terms)])
    literal: Form = "reduced" if form == "recursive" else form
    listing = equations(tree, kinds, literal, gravity, zeros, max_terms)
    robot = symbolic_robot(tree, tree.gravity_or(gravity))
    derived = _derived_equations(listing)
    symbols = _symbols_by_name(listing, robot)
    listed = read_listing(text, symbols, max_terms)
    if not listed:
        raise ExpressionError("the listing holds no equation")
    expand = make_expander(robot, Budget(max_terms))
    differences = {}
    for name, value in listed.items():
        if name in derived:
            differences[name] = expand(value - derived[name])
        elif name in symbols:
            raise ExpressionError(
                f"'{name}' is the robot's own and not for a listing to define"
            )
        elif len(re.findall(rf"\b{name}\b", text)) < 2:
            raise UnknownName("equation", name, derived)
    return differences


def _listed_kinds(names: Sequence[str]) -> list[str]:
    """Names of the equation kinds in a listing; joint forces if no name is recognised.

    A kind is recognised if a left-hand side matches its regular expression `results`. Regressors
    are not recognised.

    Args:
        names: Left-hand sides of the listing.
    """
    kinds = [
        kind.name
        for kind in KINDS.values()
        if any(re.fullmatch(kind.results, name, re.ASCII) for name in names)
        and not kind.is_regressor
    ]
    return kinds or ["joint-forces"]


def _derived_equations(listing: Listing) -> dict[str, Expression]:
    """Derived equations and definitions, keyed by name.

    References to other equations are substituted.

    Definitions are also stored under a second name, with mm for mbar as in [FRS96].
    """
    meanings: dict[Factor, Expression] = {}
    for each in listing.equations:
        for name, value in each.program.steps:
            meanings[name] = substitute(value, meanings.get)
    derived = {name.name: value for name, value in meanings.items()}
    for label, value in listing.definitions:
        derived[label] = derived[label.replace("mbar", "mm")] = value
    return derived


def _symbols_by_name(listing: Listing, robot: SymbolicRobot) -> dict[str, Expression]:
    """Symbols of a robot's equations as expressions, keyed by name.

    The symbols are coordinates, constants and parameters.

    Symbols with mbar in the name are also stored under a second name, with mm as in [FRS96].
    """
    symbols = [*map(single_factor, [*robot.q, *robot.qd, *robot.qdd]), *robot.values]
    for each in listing.equations:
        symbols += [
            parameter.symbol for parameter in each.parameters if parameter.symbol
        ]
    for _, value in listing.definitions:
        symbols += leaf_factors(value)
    by_name = {symbol.name: factor_expression(symbol) for symbol in symbols}
    return by_name | {
        name.replace("mbar", "mm"): value for name, value in by_name.items()
    }


def read_listing(
    text: str, names: Mapping[str, Expression], max_terms: int = MAX_TERMS
) -> dict[str, Expression]:
    """Parse the equations of a listing into expressions keyed by left-hand side.

    The equations keep their order, and each may refer to the equations above it.

    Args:
        text: NAME = expression; lines that begin with a blank or a sign continue the previous
            line, lines that begin with *, # or [ are comments.
        names: Expressions of the predefined names; a listing may repeat but not change them.
        max_terms: Largest number of terms, including those of substituted names.

    Raises:
        ExpressionError: The listing cannot be read, or has more terms than `max_terms`.
        UnknownName: The listing contains an undefined name.
    """
    known = dict(names)
    equations_by_name: dict[str, Expression] = {}
    budget = Budget(max_terms)
    for line, name, right in _statements(text, max_terms):
        if not right.strip() or not _IDENTIFIER.fullmatch(name):
            raise ExpressionError(
                f"line {line}: NAME = expression, found '{name[:40]}'"
            )
        if name in equations_by_name:
            raise ExpressionError(f"line {line}: {name} is defined twice")
        try:
            equations_by_name[name] = _right_hand_side(right, known, budget)
        except ExpressionError as error:
            raise ExpressionError(f"line {line}: {error}") from None
        except UnknownName as error:
            raise UnknownName(f"name on line {line}", error.name, error.known) from None
        known.setdefault(name, equations_by_name[name])
    return equations_by_name


def _statements(text: str, max_terms: int) -> Iterator[tuple[int, str, str]]:
    """Yield first line number, name and right-hand side of each equation of a listing.

    Raises:
        ExpressionError: The listing has more than `CHARACTERS_PER_TERM` (40) times `max_terms`
            characters.
    """
    limit = CHARACTERS_PER_TERM * max_terms
    if len(text) > limit:
        raise ExpressionError(
            f"a listing of more than {limit} characters; --max-terms N (max_terms=N) allows more"
        )
    statements: list[tuple[int, list[str]]] = []
    for line, text_line in enumerate(text.splitlines(), start=1):
        if text_line.startswith(("*", "#", "[")) or not text_line.strip():
            continue
        if statements and text_line[0] in " \t+-":
            statements[-1][1].append(text_line)
        else:
            statements.append((line, [text_line]))
    for line, lines in statements:
        name, _, right_side = "".join(lines).partition("=")
        yield line, name.strip(), right_side


def _right_hand_side(
    text: str, names: Mapping[str, Expression], budget: Budget
) -> Expression:
    """Expression of the right-hand side of an equation; ^ and ** denote powers.

    Summands are parsed as the items of a tuple, so that a long sum is not nested deeply.

    Raises:
        ExpressionError: The text is not an expression, divides by zero or is nested too deeply.
    """
    summands = _SUMMAND_END.sub(r"\1,", text.replace("^", "**")).strip()
    try:
        return _node_expression(
            ast.parse(f"{summands},", mode="eval").body, names, budget
        )
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


def _node_expression(
    node: ast.AST, names: Mapping[str, Expression], budget: Budget
) -> Expression:
    """Expression of a node of a syntax tree; a tuple is a sum.

    Raises:
        ExpressionError: The node is not a sum, product, quotient by a number, or power with an
            exponent from 1 to `MAX_EXPONENT` (20).
        UnknownName: A name is neither in `names` nor a sine or cosine.
    """
    match node:
        case ast.Tuple(elts=summands):
            terms: list[Term] = []
            for summand in summands:
                summand_terms = _node_expression(summand, names, budget).terms
                budget.write(max(1, len(summand_terms)))
                terms += summand_terms
            return collect(terms)
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
            value = _node_expression(operand, names, budget)
            return -value if isinstance(sign, ast.USub) else value
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            factors = [
                _node_expression(left, names, budget),
                _node_expression(right, names, budget),
            ]
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            value = _node_expression(left, names, budget)
            return value / _node_number(right)
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            exponent = _node_number(right)
            if exponent not in range(1, MAX_EXPONENT + 1):
                raise ExpressionError(
                    f"an exponent is a number from 1 to {MAX_EXPONENT}"
                )
            factors = [_node_expression(left, names, budget)] * int(exponent)
        case ast.Name(id=name):
            return names[name] if name in names else _sine_or_cosine(name, names)
        case _:
            return number(_node_number(node))
    # a sum becomes a bracket
    budget.multiply(sum(len(factor.terms) for factor in factors))
    return expression(prod(factors))


def _node_number(node: ast.AST) -> Number:
    """Number of a constant node of a syntax tree."""
    match node:
        case ast.Constant(value=float() | int() as size) if not isinstance(size, bool):
            return size
    raise ExpressionError(
        f"'{ast.unparse(node)[:40]}' is no sum, product, power or number"
    )


def _sine_or_cosine(name: str, names: Mapping[str, Expression]) -> Expression:
    """Sine or cosine with an abbreviated name, such as S223 for sin(2 q2 + q3).

    Underscores separate joint numbers, and m denotes subtraction: C_12_m3 is cos(q12 - q3).

    Raises:
        UnknownName: The name is not an abbreviation of this form, or refers to a missing joint.
    """
    if not _SINE_OR_COSINE_NAME.fullmatch(name):
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
