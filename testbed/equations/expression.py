"""Expressions as ROBOTRAN keeps them: sums of terms, terms products of factors.

A factor is a parameter, a coordinate or one of its derivatives, a constant of the geometry,
the cosine or sine of an expression, an auxiliary variable, or an expression in brackets; a
term carries a number besides. Expressions are values: immutable, shared, always in order;
equal terms of opposite sign cancel at every operation. Brackets are not multiplied out;
`polynomial.expand` does that, and knows the identities of trigonometry. `Budget` counts terms.

Order     factors by nature, then by name; terms by their factors; numbers do not count
Numbers   integers and binary fractions, so that arithmetic on them is exact
Names     S223 = sin(2 q2 + q3)
Source    [FRS96] section 3, figure 4
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from enum import IntEnum
from hashlib import blake2s
from math import prod
from typing import Any, TypeAlias
from weakref import WeakValueDictionary

from testbed.core.base.errors import ExpressionError

Number: TypeAlias = int | float
LARGEST_NUMBER = 1e150
"""The square of this is still a number."""
LONGEST_NAME = 200
"""Characters of a bracket's name; brackets within brackets would double it again and again."""
MAX_TERMS = 150_000
"""Terms that take some ten seconds to write, and that nobody reads."""
PRODUCT = 0.1
"""What multiplying two terms counts: most products are added up to fewer terms."""
Key: TypeAlias = tuple[int, int, str]


class Nature(IntEnum):
    """What a factor is; the order of factors and, through them, of terms."""

    ACCELERATION = 0
    VELOCITY = 1
    PARAMETER = 2
    POSITION = 3
    CONSTANT = 4
    COSINE = 5
    SINE = 6
    AUXILIARY = 7
    BRACKET = 8


@dataclass(frozen=True, eq=False, repr=False, slots=True, weakref_slot=True)
class Factor:
    """One factor of a term; equal factors are the same object.

    Attributes:
        nature: What it is.
        name: As printed; of a bracket, its content.
        content: The angle of a cosine or sine, what an auxiliary variable stands for, what
            is between brackets; else None.
        rank: Its place among factors of its nature; of a coordinate, the index of its joint.
        key: Its place in the order.
    """

    nature: Nature
    name: str
    content: Expression | None
    rank: int
    key: Key

    @staticmethod
    def of(
        nature: Nature, name: str, content: Expression | None = None, rank: int = 0
    ) -> Factor:
        """The factor of these properties, made if there is none yet."""
        label = (nature, rank, name, content)
        found = _FACTORS.get(label)
        if found is None:
            key = (int(nature), rank, name)
            found = _FACTORS[label] = Factor(nature, name, content, rank, key)
        return found

    @property
    def inside(self) -> Expression | None:
        """What is between brackets; None for other factors."""
        return self.content if self.nature is Nature.BRACKET else None

    def __repr__(self) -> str:
        return self.name

    def __lt__(self, other: Factor) -> bool:
        return self.key < other.key


_FACTORS: WeakValueDictionary[Hashable, Factor] = WeakValueDictionary()

Factors: TypeAlias = tuple[Factor, ...]
Term: TypeAlias = tuple[Factors, Number]


@dataclass(frozen=True, repr=False, slots=True)
class Expression:
    """A sum of terms in order; see the module's description.

    Supports +, - and * with expressions and numbers. `==` says whether two expressions
    are written alike; they are equal if their difference, expanded, has no parts.

    Attributes:
        terms: (factors, number), in order, as `collect` makes them; none of the numbers is zero.
    """

    terms: tuple[Term, ...]

    def __bool__(self) -> bool:
        return bool(self.terms)

    def __repr__(self) -> str:
        return as_text(self)

    def __neg__(self) -> Expression:
        return Expression(tuple((factors, -number) for factors, number in self.terms))

    def __add__(self, other: Any) -> Any:
        if not isinstance(other, Expression | int | float):
            return NotImplemented
        added = expression(other).terms
        return collect((*self.terms, *added)) if added else self

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return (-self) + other

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Expression):
            return _product(self, other)
        if not isinstance(other, int | float):
            return NotImplemented
        if other in (0, 1):
            return self if other else 0
        return Expression(
            tuple((factors, exact(size * other)) for factors, size in self.terms)
        )

    __rmul__ = __mul__

    def __truediv__(self, other: Number) -> Expression:
        """By a number; exact if it is a power of two."""
        return Expression(
            tuple((factors, exact(size / other)) for factors, size in self.terms)
        )

    def sin(self) -> Expression:
        """Sine, as NumPy asks for it of arrays of expressions."""
        return sine(self)

    def cos(self) -> Expression:
        """Cosine, likewise."""
        return cosine(self)


ZERO = Expression(())


def symbol(nature: Nature, name: str, rank: int = 0) -> Expression:
    """A symbol as an expression.

    Args:
        nature: What it is.
        name: As printed.
        rank: Its place among symbols of its nature; those of one rank go by name.
    """
    return of(Factor.of(nature, name, None, rank))


def of(factor: Factor) -> Expression:
    """A factor as an expression."""
    return Expression((((factor,), 1),))


def factor(symbol: Expression) -> Factor:
    """Factor that an expression consists of; the inverse of `of`."""
    ((factors, _),) = symbol.terms
    return factors[0]


def number(value: Number) -> Expression:
    """A number as an expression."""
    return Expression((((), exact(value)),)) if value else ZERO


def expression(value: Any) -> Expression:
    """An expression, or a number as one."""
    return value if isinstance(value, Expression) else number(value)


def sine(angle: Expression) -> Expression:
    """Sine of an expression, odd."""
    if angle.terms[0][1] < 0:
        return -sine(-angle)
    return of(Factor.of(Nature.SINE, _trig("S", angle), angle))


def cosine(angle: Expression) -> Expression:
    """Cosine of an expression, even."""
    if angle.terms[0][1] < 0:
        angle = -angle
    return of(Factor.of(Nature.COSINE, _trig("C", angle), angle))


def _trig(letter: str, angle: Expression) -> str:
    """S223 of 2*q2 + q3; S_2_m3 of q2 - q3, S_12 of q12."""
    labels = angle_labels(angle, "m")
    if all(len(label) == 1 for label in labels):
        return letter + "".join(labels)
    return f"{letter}_{'_'.join(labels)}"


def angle_labels(angle: Expression, minus: str) -> list[str]:
    """Labels of the coordinates that an angle adds up: 2, 2, m3 of 2*q2 - q3.

    Args:
        angle: A sum of coordinates.
        minus: Before labels of those that are subtracted.
    """
    labels = []
    for factors, size in angle.terms:
        label = "".join(factor.name for factor in factors).removeprefix("q")
        labels += [minus * (size < 0) + label] * int(abs(size))
    return labels


def collect(terms: Iterable[Term]) -> Expression:
    """Terms in order, equal ones added, those that cancel gone."""
    sums: dict[Factors, Number] = {}
    for factors, value in terms:
        sums[factors] = sums.get(factors, 0) + value
    kept = [(factors, exact(value)) for factors, value in sums.items() if value != 0]
    kept.sort(key=lambda term: [factor.key for factor in term[0]])
    return Expression(tuple(kept))


def substitute(
    value: Expression, meaning: Callable[[Factor], Expression | None]
) -> Expression:
    """The expression with other expressions in the place of some factors.

    Args:
        value: Any.
        meaning: What to put in a factor's place; None leaves it.
    """
    terms: list[Term] = []
    for factors, size in value.terms:
        parts = [meaning(factor) for factor in factors]
        if all(part is None for part in parts):
            terms.append((factors, size))
            continue
        known = zip(factors, parts, strict=True)
        product = (of(factor) if part is None else part for factor, part in known)
        terms += expression(prod(product, start=number(size))).terms
    return collect(terms)


def bracket(inside: Expression) -> tuple[Factor, Number]:
    """A sum as a factor, and the number taken out of it.

    Sums that differ by their sign, or by a number that all terms share, have one bracket.
    """
    first = inside.terms[0][1]
    sizes = {abs(value) for _, value in inside.terms}
    out = first if len(sizes) == 1 else 1 if first > 0 else -1
    plain = inside / out
    name = f"({as_text(plain)})"
    if len(name) > LONGEST_NAME:
        name = f"{name[: LONGEST_NAME - 33]}~{blake2s(name.encode(), digest_size=16).hexdigest()}"
    return Factor.of(Nature.BRACKET, name, plain), out


def as_text(value: Expression) -> str:
    """Plain text: a*b - 2*c."""
    text = ""
    for factors, size in value.terms:
        names = [factor.name for factor in factors]
        if abs(size) != 1 or not names:
            names.insert(0, f"{abs(size):.12g}")
        sign = "-" if size < 0 else "+"
        text += (
            f" {sign} {'*'.join(names)}"
            if text
            else sign.replace("+", "") + "*".join(names)
        )
    return text or "0"


def _product(a: Expression, b: Expression) -> Any:
    if not a.terms or not b.terms:
        return 0
    for one, two in ((a, b), (b, a)):
        if len(one.terms) == 1 and not one.terms[0][0]:
            return two * one.terms[0][1]
    left, size = _single(a)
    right, other = _single(b)
    factors = sorted((*left, *right), key=lambda factor: factor.key)
    return Expression(((tuple(factors), exact(size * other)),))


def _single(value: Expression) -> Term:
    """One term: the expression's own, or its bracket."""
    if len(value.terms) == 1:
        return value.terms[0]
    factor, out = bracket(value)
    return (factor,), out


def exact(value: Number) -> Number:
    """The number, as an integer where it is one.

    Raises:
        ExpressionError: It is too large for two such numbers to be multiplied, or is none.
    """
    if not -LARGEST_NUMBER <= value <= LARGEST_NUMBER:
        raise ExpressionError(
            f"a number beyond {LARGEST_NUMBER:g}, too large to calculate with"
        )
    return int(value) if value == int(value) else float(value)


def auxiliaries(values: Iterable[Expression]) -> list[Factor]:
    """The auxiliary variables and brackets that values refer to, each after those it needs."""

    def names(value: Expression) -> list[Factor]:
        return [
            f
            for factors, _ in value.terms
            for f in factors
            if f.nature >= Nature.AUXILIARY
        ]

    first = [factor for value in values for factor in names(value)]
    return depth_first(first, lambda factor: names(factor.content or ZERO))


def depth_first(
    first: Iterable[Factor], needs: Callable[[Factor], list[Factor]]
) -> list[Factor]:
    """Factors and all that they need, each after what it needs; as deep as may be.

    Args:
        first: Where to start.
        needs: What one of them refers to.
    """
    order: list[Factor] = []
    seen: set[Factor] = set()
    todo = [(factor, False) for factor in first][::-1]
    while todo:
        factor, ready = todo.pop()
        if ready:
            order.append(factor)
        elif factor not in seen:
            seen.add(factor)
            todo.append((factor, True))
            todo += [
                (each, False) for each in reversed(needs(factor)) if each not in seen
            ]
    return order


class Budget:
    """Counts terms while equations are written or read.

    Attributes:
        terms: How many there may be.
        spent: How many there were so far.
    """

    def __init__(self, terms: int = MAX_TERMS, shorter: str = "") -> None:
        """Nothing spent yet.

        Args:
            terms: How many there may be.
            shorter: What to ask for instead, if anything.
        """
        self.terms = terms
        self.spent = 0.0
        self._shorter = shorter

    def write(self, terms: int) -> None:
        """Count terms that are written down.

        Raises:
            ExpressionError: There are too many.
        """
        self.spent += terms
        if self.spent > self.terms:
            raise ExpressionError(
                f"this takes more than {self.terms} terms, those on the way included: "
                f"{self._shorter}--max-terms N (max_terms=N) allows more, at the price of time "
                "and memory"
            )

    def multiply(self, products: int) -> None:
        """Count products of terms, before they are made.

        Raises:
            ExpressionError: There are too many.
        """
        self.spent += PRODUCT * products
        self.write(0)
