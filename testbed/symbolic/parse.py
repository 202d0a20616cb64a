"""A listing read back.

Reads the notation of `languages.paper`, the paper's: sums of products of names and numbers,
brackets, NAME = ... on one line or several. Nothing of it is ever executed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from testbed.errors import ExpressionError, UnknownName
from testbed.symbolic.budget import MAX_TERMS, Budget
from testbed.symbolic.expression import (
    LARGEST_NUMBER,
    Expression,
    Term,
    collect,
    expression,
    number,
)
from testbed.symbolic.polynomial import LARGEST as HIGHEST_DEGREE
from testbed.symbolic.symbol_algebra import cosine, sine

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
