"""Symbolic expressions in ROBOTRAN's form: sums of products of factors.

A factor is a parameter, a coordinate or one of its derivatives, a constant of the geometry,
the cosine or sine of an expression, an auxiliary variable, or an expression in brackets; a
term has a numerical coefficient as well. Expressions are immutable values in normal order;
equal terms of opposite sign cancel at every operation. Brackets are not multiplied out:
`PolynomialRing.expand` does that, with the identities of trigonometry. `Budget` counts terms.

Order         factors by nature, then by name; terms by their factors, not by coefficient
Coefficients  integers and binary fractions, so that arithmetic on them is exact
Names         S223 = sin(2 q2 + q3)
Source        [FRS96] section 3, figure 4
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
MAX_COEFFICIENT = 1e150
"""Largest magnitude of a coefficient; its square is still finite."""
MAX_NAME_SIZE = 200
"""Largest length of a bracket's name; a longer name is cut and completed by its hash."""
MAX_TERMS = 150_000
"""Default limit for the number of terms; 150 000 terms take about ten seconds to write."""
PRODUCT_WEIGHT = 0.1
"""Weight of a product of two terms in the count of terms: most products are collected."""
SortKey: TypeAlias = tuple[int, int, str]


class FactorKind(IntEnum):
    """Kind of a factor; the numbers give the order of the factors in a term."""

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
    """Interned factor of a term: equal factors are the same object.

    Attributes:
        kind: Kind of the factor.
        name: Printed name; for a bracket, the text of the content.
        content: Angle of a cosine or sine, definition of an auxiliary variable, or sum in a
            bracket; None for other factors.
        rank: Rank among factors of the same kind; joint index of a coordinate.
        key: Sorting key: kind, rank, name.
    """

    kind: FactorKind
    name: str
    content: Expression | None
    rank: int
    key: SortKey

    @staticmethod
    def interned(
        nature: FactorKind, name: str, content: Expression | None = None, rank: int = 0
    ) -> Factor:
        """Factor with the given properties, from the table of existing factors if possible."""
        label = (nature, rank, name, content)
        factor = _FACTORS.get(label)
        if factor is None:
            key = (int(nature), rank, name)
            factor = _FACTORS[label] = Factor(nature, name, content, rank, key)
        return factor

    @property
    def bracket_content(self) -> Expression | None:
        """Sum in a bracket; None for other factors."""
        return self.content if self.kind is FactorKind.BRACKET else None

    def __repr__(self) -> str:
        return self.name

    def __lt__(self, other: Factor) -> bool:
        return self.key < other.key


_FACTORS: WeakValueDictionary[Hashable, Factor] = WeakValueDictionary()

Factors: TypeAlias = tuple[Factor, ...]
Term: TypeAlias = tuple[Factors, Number]


@dataclass(frozen=True, repr=False, slots=True)
class Expression:
    """Immutable sum of terms in normal order.

    Supports +, - and * with expressions and numbers. `==` compares the written form; two
    expressions are mathematically equal if their difference expands to zero.

    Attributes:
        terms: Pairs of factors and coefficient, sorted as by `collect`, without zeros.
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
            tuple(
                (factors, exact_number(coefficient * other))
                for factors, coefficient in self.terms
            )
        )

    __rmul__ = __mul__

    def __truediv__(self, other: Number) -> Expression:
        """Quotient by a number; exact for a power of two."""
        return Expression(
            tuple(
                (factors, exact_number(coefficient / other))
                for factors, coefficient in self.terms
            )
        )

    def sin(self) -> Expression:
        """Sine of the expression, for `numpy.sin` of an object array."""
        return sine(self)

    def cos(self) -> Expression:
        """Cosine of the expression, for `numpy.cos` of an object array."""
        return cosine(self)


ZERO = Expression(())


def symbol(nature: FactorKind, name: str, rank: int = 0) -> Expression:
    """Expression that consists of one symbol.

    Args:
        nature: Kind of the symbol.
        name: Printed name.
        rank: Rank among symbols of the same kind; symbols of equal rank are sorted by name.
    """
    return factor_expression(Factor.interned(nature, name, None, rank))


def factor_expression(factor: Factor) -> Expression:
    """Expression that consists of one factor."""
    return Expression((((factor,), 1),))


def single_factor(symbol: Expression) -> Factor:
    """Factor of an expression that consists of one factor; inverse of `factor_expression`."""
    ((factors, _),) = symbol.terms
    return factors[0]


def number(value: Number) -> Expression:
    """Expression of a constant."""
    return Expression((((), exact_number(value)),)) if value else ZERO


def expression(value: Any) -> Expression:
    """Value as an expression; a number becomes a constant expression."""
    return value if isinstance(value, Expression) else number(value)


def sine(angle: Expression) -> Expression:
    """Sine of a sum of multiples of coordinates; a leading minus sign is moved out."""
    if angle.terms[0][1] < 0:
        return -sine(-angle)
    return factor_expression(
        Factor.interned(FactorKind.SINE, _trigonometric_name("S", angle), angle)
    )


def cosine(angle: Expression) -> Expression:
    """Cosine of a sum of multiples of coordinates; a leading minus sign is removed."""
    if angle.terms[0][1] < 0:
        angle = -angle
    return factor_expression(
        Factor.interned(FactorKind.COSINE, _trigonometric_name("C", angle), angle)
    )


def _trigonometric_name(letter: str, angle: Expression) -> str:
    """Name of a sine or cosine, such as S223 for sin(2*q2 + q3).

    Underscores separate labels with a minus sign or several digits: S_2_m3 for sin(q2 - q3), S_12
    for sin(q12).

    Args:
        letter: S for a sine, C for a cosine.
        angle: Sum of multiples of coordinates.
    """
    labels = angle_labels(angle, "m")
    if all(len(label) == 1 for label in labels):
        return letter + "".join(labels)
    return f"{letter}_{'_'.join(labels)}"


def angle_labels(angle: Expression, minus: str) -> list[str]:
    """Labels of the coordinates in a sum of angles: `2, 2, m3` for `2*q2 - q3`.

    Args:
        angle: Sum of multiples of coordinates.
        minus: Prefix of the labels of subtracted coordinates.
    """
    labels = []
    for factors, coefficient in angle.terms:
        label = "".join(factor.name for factor in factors).removeprefix("q")
        labels += [minus * (coefficient < 0) + label] * int(abs(coefficient))
    return labels


def collect(terms: Iterable[Term]) -> Expression:
    """Sum of terms in normal order; like terms are added and zero terms dropped."""
    sums: dict[Factors, Number] = {}
    for factors, value in terms:
        sums[factors] = sums.get(factors, 0) + value
    collected = [
        (factors, exact_number(value)) for factors, value in sums.items() if value != 0
    ]
    collected.sort(key=lambda term: [factor.key for factor in term[0]])
    return Expression(tuple(collected))


def substitute(
    value: Expression, replacement: Callable[[Factor], Expression | None]
) -> Expression:
    """Replace factors of an expression with other expressions.

    Args:
        value: The expression.
        replacement: Function that returns the replacement of a factor, or None to keep the factor.
    """
    terms: list[Term] = []
    for factors, coefficient in value.terms:
        replacements = [replacement(factor) for factor in factors]
        if all(part is None for part in replacements):
            terms.append((factors, coefficient))
            continue
        pairs = zip(factors, replacements, strict=True)
        product = (
            factor_expression(factor) if part is None else part
            for factor, part in pairs
        )
        terms += expression(prod(product, start=number(coefficient))).terms
    return collect(terms)


def bracket(total: Expression) -> tuple[Factor, Number]:
    """Bracket factor of a sum, and the coefficient taken out of the bracket.

    Sums that differ only by sign, or by a coefficient common to all terms, share one bracket.
    """
    first_coefficient = total.terms[0][1]
    magnitudes = {abs(value) for _, value in total.terms}
    common = (
        first_coefficient
        if len(magnitudes) == 1
        else 1
        if first_coefficient > 0
        else -1
    )
    normalized = total / common
    name = f"({as_text(normalized)})"
    if len(name) > MAX_NAME_SIZE:
        name = f"{name[: MAX_NAME_SIZE - 33]}~{blake2s(name.encode(), digest_size=16).hexdigest()}"
    return Factor.interned(FactorKind.BRACKET, name, normalized), common


def as_text(value: Expression) -> str:
    """Plain text of an expression, such as a*b - 2*c."""
    text = ""
    for factors, coefficient in value.terms:
        names = [factor.name for factor in factors]
        if abs(coefficient) != 1 or not names:
            names.insert(0, f"{abs(coefficient):.12g}")
        sign = "-" if coefficient < 0 else "+"
        text += (
            f" {sign} {'*'.join(names)}"
            if text
            else sign.replace("+", "") + "*".join(names)
        )
    return text or "0"


def _product(a: Expression, b: Expression) -> Any:
    """Product of two expressions; a sum of several terms becomes a bracket."""
    if not a.terms or not b.terms:
        return 0
    for operand, other_operand in ((a, b), (b, a)):
        if len(operand.terms) == 1 and not operand.terms[0][0]:
            return other_operand * operand.terms[0][1]
    factors_a, coefficient_a = _single_term(a)
    factors_b, coefficient_b = _single_term(b)
    factors = sorted((*factors_a, *factors_b), key=lambda factor: factor.key)
    return Expression(((tuple(factors), exact_number(coefficient_a * coefficient_b)),))


def _single_term(value: Expression) -> Term:
    """Expression as a single term; a sum of several terms becomes a bracket."""
    if len(value.terms) == 1:
        return value.terms[0]
    factor, coefficient = bracket(value)
    return (factor,), coefficient


def exact_number(value: Number) -> Number:
    """Number, converted to an integer if it is whole.

    Raises:
        ExpressionError: The number is NaN, or larger than `MAX_COEFFICIENT` (1e150) in magnitude.
    """
    if not -MAX_COEFFICIENT <= value <= MAX_COEFFICIENT:
        raise ExpressionError(
            f"a number beyond {MAX_COEFFICIENT:g}, too large to calculate with"
        )
    return int(value) if value == int(value) else float(value)


def sorted_dependencies(values: Iterable[Expression]) -> list[Factor]:
    """Auxiliary variables and brackets of expressions, each after its dependencies."""

    def references(value: Expression) -> list[Factor]:
        return [
            f
            for factors, _ in value.terms
            for f in factors
            if f.kind >= FactorKind.AUXILIARY
        ]

    roots = [factor for value in values for factor in references(value)]
    return depth_first_order(roots, lambda factor: references(factor.content or ZERO))


def depth_first_order(
    roots: Iterable[Factor], dependencies: Callable[[Factor], list[Factor]]
) -> list[Factor]:
    """Factors and dependencies in depth-first order, each after the factors it depends on.

    An explicit stack instead of recursion allows dependencies of any depth.

    Args:
        roots: Factors to start from.
        dependencies: Function that returns the factors to which a factor refers.
    """
    order: list[Factor] = []
    visited: set[Factor] = set()
    stack = [(factor, False) for factor in roots][::-1]
    while stack:
        factor, is_expanded = stack.pop()
        if is_expanded:
            order.append(factor)
        elif factor not in visited:
            visited.add(factor)
            stack.append((factor, True))
            stack += [
                (each, False)
                for each in reversed(dependencies(factor))
                if each not in visited
            ]
    return order


class Budget:
    """Counter of terms, with a limit, for the derivation and reading of equations.

    Attributes:
        terms: Largest number of terms.
        spent: Number of terms so far; a product of two terms counts as `PRODUCT_WEIGHT` (0.1).
    """

    def __init__(self, terms: int = MAX_TERMS, advice: str = "") -> None:
        """Create a counter at zero.

        Args:
            terms: Largest number of terms.
            advice: Beginning of the advice in the error message, such as a shorter form.
        """
        self.terms = terms
        self.spent = 0.0
        self._advice = advice

    def write(self, terms: int) -> None:
        """Add terms of an expression to the count.

        Raises:
            ExpressionError: The limit is exceeded.
        """
        self.spent += terms
        if self.spent > self.terms:
            raise ExpressionError(
                f"this takes more than {self.terms} terms, those on the way included: "
                f"{self._advice}--max-terms N (max_terms=N) allows more, at the price of time "
                "and memory"
            )

    def multiply(self, products: int) -> None:
        """Add products of terms to the count, before the multiplication.

        Raises:
            ExpressionError: The limit is exceeded.
        """
        self.spent += PRODUCT_WEIGHT * products
        self.write(0)
