"""A listing read back, and held against the robot's own equations.

Reads the notation of `languages.paper`, the paper's: sums of products of names and numbers,
brackets, NAME = ... on one line or several. Nothing of it is ever executed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from testbed.errors import ExpressionError, UnknownName
from testbed.symbolic.expression import Expression, collect, expression, number
from testbed.symbolic.symbol_algebra import cosine, sine

_TOKEN = re.compile(
    r"\s*(?:((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|([A-Za-z_]\w*)|(\*\*|[-+*/^()]))", re.ASCII
)
_WAVE = re.compile(r"[SC](?:\d+|(?:_m?\d+)+)", re.ASCII)
_NAME = re.compile(r"\s*[A-Za-z_]\w*\s*", re.ASCII)

DEEPEST = 50
"""Brackets within brackets; more would overflow the reader's stack."""
HIGHEST = 20
"""Largest exponent."""


@dataclass
class _Reader:
    """Recursive descent through one right-hand side."""

    tokens: list[str]
    names: Mapping[str, Expression]
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
        total = self.product() if self.next() not in ("+", "-") else number(0)
        while self.next() in ("+", "-"):
            sign = 1 if self.take() == "+" else -1
            total = total + self.product() * sign
        return total

    def product(self) -> Expression:
        """Powers with * between them; division by numbers."""
        total = self.power()
        while self.next() in ("*", "/"):
            divides = self.take() == "/"
            other = self.power()
            if not divides:
                total = expression(total * other)
            elif len(other.terms) == 1 and not other.terms[0][0]:
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
        if not exponent.isdecimal() or not 1 <= int(exponent) <= HIGHEST:
            raise ExpressionError(f"an exponent is a number from 1 to {HIGHEST}")
        total = base
        for _ in range(int(exponent) - 1):
            total = expression(total * base)
        return expression(total * sign)

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
        if re.match(r"[\d.]", token):
            value = float(token)
            if value == float("inf"):
                raise ExpressionError(f"the number {token} is too large")
            return number(value)
        if token in self.names:
            return self.names[token]
        if _WAVE.fullmatch(token):
            return wave(token, self.names)
        if re.match(r"[A-Za-z_]", token):
            raise UnknownName("name", token, self.names)
        raise ExpressionError(f"'{token or 'the end'}' where a number or name should be")


def read_listing(text: str, names: Mapping[str, Expression]) -> dict[str, Expression]:
    """The equations of a listing, in its order; later ones may refer to earlier ones.

    Args:
        text: NAME = expression; lines that begin with a blank or a sign continue the one
            before, those that begin with * or # are comments.
        names: What names stand for; a listing may say what they are, and does not change it.

    Raises:
        ExpressionError: It cannot be read.
        UnknownName: It holds a name that stands for nothing.
    """
    known = dict(names)
    found: dict[str, Expression] = {}
    for line, statement in _statements(text):
        name, equals, right = statement.partition("=")
        name = name.strip()
        if not equals or not _NAME.fullmatch(name):
            raise ExpressionError(f"line {line}: NAME = expression, found '{statement[:40]}'")
        if name in found:
            raise ExpressionError(f"line {line}: {name} is defined twice")
        reader = _Reader(_tokens(right, line), known)
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
        UnknownName: There is no such joint.
    """
    label = name[1:]
    parts = label.strip("_").split("_") if "_" in label else list(label)
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
    found, place = [], 0
    text = text.rstrip()
    while place < len(text):
        match = _TOKEN.match(text, place)
        if match is None:
            raise ExpressionError(f"line {line}: '{text[place:].strip()[:10]}' cannot be read")
        found.append(next(part for part in match.groups() if part))
        place = match.end()
    return found
