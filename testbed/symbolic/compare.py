"""Somebody's listing, read back and compared with the robot's own equations, term by term.

Reads the notation of `languages.text`, the paper's: sums of products of names and numbers,
brackets, NAME = ... on one line or several. Nothing of it is ever executed.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from testbed.errors import ExpressionError, UnknownName
from testbed.robot.tree import Tree
from testbed.symbolic.equations import FORMS, KINDS, Form, Listing, equations, expander
from testbed.symbolic.expression import (
    LARGEST_NUMBER,
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
from testbed.symbolic.polynomial import LARGEST as HIGHEST_DEGREE
from testbed.symbolic.robot import Robot, draw

_WORD = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_]\w*|\*\*|[-+*/^()]"
_TOKEN = re.compile(_WORD, re.ASCII)
_READABLE = re.compile(rf"(?:\s*+(?:{_WORD}))*+\s*+", re.ASCII)
_NUMBER = frozenset("0123456789.")
_WAVE = re.compile(r"[SC](?:\d+|(?:_m?\d+)+)", re.ASCII)
_NAME = re.compile(r"\s*[A-Za-z_]\w*\s*", re.ASCII)

DEEPEST = 50
"""Brackets within brackets; more would overflow the reader's stack."""
HIGHEST = 20
"""Largest exponent."""
EXPONENTS = frozenset(str(k) for k in range(1, HIGHEST + 1))
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
        text: The listing, in the notation of [FRS96]; see `parse.read_listing`. Names on the
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
    kinds = _kinds(defined_names(text, max_terms))
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


def _kinds(names: Iterable[str]) -> list[str]:
    """The kinds of equations that a listing's names belong to."""
    names = list(names)
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


@dataclass
class _Reader:
    """Recursive descent through one right-hand side."""

    tokens: list[str]
    names: Mapping[str, Expression]
    budget: Budget
    place: int = 0
    depth: int = 0

    def next(self) -> str:
        """The token at hand, "" at the end."""
        return self.tokens[self.place] if self.place < len(self.tokens) else ""

    def take(self) -> str:
        """The token at hand; the next one is at hand then."""
        self.place += 1
        return self.tokens[self.place - 1] if self.place <= len(self.tokens) else ""

    def sum(self) -> Expression:
        """Terms with signs."""
        terms: list[Term] = []
        first = True
        while first or self.next() in ("+", "-"):
            sign = -1 if self.next() == "-" else 1
            if self.next() in ("+", "-"):
                self.take()
            part = expression(self.product() * sign).terms
            self.budget.write(max(1, len(part)))
            terms += part
            first = False
        return collect(terms)

    def product(self) -> Expression:
        """Powers with * between them; division by numbers."""
        total = self.power()
        factors = 1
        while self.next() in ("*", "/"):
            factors += 1
            if factors > HIGHEST_DEGREE:
                raise ExpressionError(f"a product of more than {HIGHEST_DEGREE} factors")
            divides = self.take() == "/"
            other = self.power()
            if not divides:
                total = self.multiplied(total, other)
            elif len(other.terms) == 1 and not other.terms[0][0]:
                self.budget.multiply(1 + len(total.terms))
                total = total / other.terms[0][1]
            else:
                raise ExpressionError("a listing divides by numbers only, and not by zero")
        return total

    def power(self) -> Expression:
        """A factor, perhaps with a whole exponent."""
        sign = 1
        while self.next() in ("-", "+"):
            sign = -sign if self.take() == "-" else sign
        base = self.factor()
        if self.next() not in ("**", "^"):
            return expression(base * sign)
        self.take()
        exponent = self.take()
        if exponent not in EXPONENTS:
            raise ExpressionError(f"an exponent is a number from 1 to {HIGHEST}")
        total = base
        for _ in range(int(exponent) - 1):
            total = self.multiplied(total, base)
        return expression(total * sign)

    def multiplied(self, a: Expression, b: Expression) -> Expression:
        """The product of two expressions."""
        self.budget.multiply(len(a.terms) + len(b.terms))  # a sum becomes a bracket
        product = expression(a * b)
        if any(len(factors) > HIGHEST_DEGREE for factors, _ in product.terms):
            raise ExpressionError(f"a product of more than {HIGHEST_DEGREE} factors")
        return product

    def factor(self) -> Expression:
        """A number, a name, or a sum in brackets."""
        token = self.take()
        if token == "(":
            self.depth += 1
            if self.depth > DEEPEST:
                raise ExpressionError(f"brackets in more than {DEEPEST} brackets")
            inside = self.sum()
            if self.take() != ")":
                raise ExpressionError("a bracket is not closed")
            self.depth -= 1
            return inside
        if token in self.names:
            return self.names[token]
        if token[:1] in _NUMBER:
            value = float(token)
            if value > LARGEST_NUMBER:
                raise ExpressionError(f"the number {token} is too large")
            return number(value)
        if _WAVE.fullmatch(token):
            return wave(token, self.names)
        if _NAME.fullmatch(token):
            raise UnknownName("name", token, self.names)
        raise ExpressionError(f"'{token or 'the end'}' where a number or name should be")


def defined_names(text: str, max_terms: int = MAX_TERMS) -> list[str]:
    """The names on the left of a listing's equations, in its order.

    Args:
        text: The listing.
        max_terms: How many terms it may have.

    Raises:
        ExpressionError: The listing is too long.
    """
    _check_length(text, max_terms)
    return [statement.partition("=")[0].strip() for _, statement in _statements(text)]


def _check_length(text: str, max_terms: int) -> None:
    most = TERM_LENGTH * max_terms
    if len(text) > most:
        raise ExpressionError(
            f"a listing of more than {most} characters; --max-terms N (max_terms=N) allows more"
        )


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
    _check_length(text, max_terms)
    known = dict(names)
    found: dict[str, Expression] = {}
    budget = Budget(max_terms)
    for line, statement in _statements(text):
        name, equals, right = statement.partition("=")
        name = name.strip()
        if not equals or not _NAME.fullmatch(name):
            raise ExpressionError(f"line {line}: NAME = expression, found '{statement[:40]}'")
        if name in found:
            raise ExpressionError(f"line {line}: {name} is defined twice")
        reader = _Reader(_tokens(right, line), known, budget)
        try:
            value = reader.sum()
            if reader.next():
                raise ExpressionError(f"'{reader.next()}' where an operator should be")
        except ExpressionError as error:
            raise ExpressionError(f"line {line}: {error}") from None
        except UnknownName as error:
            raise UnknownName(f"name on line {line}", error.name, error.known) from None
        found[name] = value
        known.setdefault(name, value)
    return found


def wave(name: str, names: Mapping[str, Expression]) -> Expression:
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


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Whole statements, with the number of their first line."""
    at, statement = 0, ""
    for place, line in enumerate(text.splitlines(), start=1):
        if line.startswith(("*", "#", "[")) or not line.strip():
            continue
        if line[0] in " \t+-":
            statement += line
            continue
        if statement:
            yield at, statement
        at, statement = place, line
    if statement:
        yield at, statement


def _tokens(text: str, line: int) -> list[str]:
    read = _READABLE.match(text)
    end = read.end() if read else 0
    if end < len(text):
        raise ExpressionError(f"line {line}: '{text[end : end + 10]}' cannot be read")
    return _TOKEN.findall(text)
