"""Expanded normal form of expressions: equal expressions have the same normal form.

A polynomial is a sum of monomials times products of cosines and sines. A monomial is one
integer, six bits per exponent, so that monomials are multiplied by adding integers. Angles fall
into groups, such as the joints whose axes are parallel. A product has at most one cosine or sine
per group, of an integer combination of the group's angles: products within a group become sums,
2 cos a cos b = cos(a - b) + cos(a + b). Different products are linearly independent. Sines and
cosines of sums across groups are expanded. Coefficients are integers and binary fractions.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product as choices
from math import prod
from typing import TypeAlias

from testbed.core.base.errors import ExpressionError
from testbed.equations.expression import (
    Budget,
    Expression,
    Factor,
    FactorKind,
    Number,
    exact_number,
    expression,
    sorted_dependencies,
)

AngleSum: TypeAlias = tuple[tuple[int, Number], ...]  # (angle number, multiple), sorted
# group, COSINE or SINE, angle
TrigFactor: TypeAlias = tuple[int, int, AngleSum]
TrigProduct: TypeAlias = tuple[TrigFactor, ...]  # at most one factor per group, sorted
TrigSum: TypeAlias = tuple[
    tuple[TrigProduct, float], ...
]  # products with their weights

COSINE, SINE = 0, 1
EXPONENT_BITS = 6
MAX_DEGREE = (1 << EXPONENT_BITS) - 1
"""Largest degree of a polynomial: exponents do not overflow their bits."""


def _product_in_group(
    group: int, a: TrigFactor, b: TrigFactor
) -> list[tuple[TrigProduct, float]]:
    """Product of two sines or cosines of one group of angles, as a sum."""
    kind = SINE if a[1] != b[1] else COSINE
    parts = (
        (combine(a[2], b[2], -1), -0.5 if a[1] < b[1] else 0.5),
        (combine(a[2], b[2], 1), -0.5 if a[1] and b[1] else 0.5),
    )
    options = []
    for index, weight in parts:
        sign, trig_product = _normalized(group, kind, index)
        options.append((trig_product, sign * weight))
    return options


def combine(a: AngleSum, b: AngleSum, sign: int) -> AngleSum:
    """Sum or difference of two angles, each an integer combination of angle numbers.

    Args:
        a: First angle.
        b: Second angle.
        sign: 1 for the sum a + b, -1 for the difference a - b.
    """
    total = dict(a)
    for angle_number, multiple in b:
        total[angle_number] = total.get(angle_number, 0) + sign * multiple
    return tuple(
        sorted(
            (angle_number, multiple)
            for angle_number, multiple in total.items()
            if multiple
        )
    )


def _normalized(group: int, kind: int, index: AngleSum) -> tuple[float, TrigProduct]:
    """Sign and normal form of a sine or cosine.

    In normal form the first multiple in the angle is positive; cos 0 is 1 and sin 0 is 0.
    """
    if not index:
        return (0.0 if kind == SINE else 1.0), ()
    sign, index = split_sign(index)
    return (sign if kind == SINE else 1.0), ((group, kind, index),)


def split_sign(index: AngleSum) -> tuple[int, AngleSum]:
    """Sign of an angle's first multiple, and the angle times this sign."""
    if index and index[0][1] < 0:
        return -1, tuple((angle_number, -multiple) for angle_number, multiple in index)
    return 1, index


@dataclass(frozen=True)
class Polynomial:
    """Sum of monomials times products of sines and cosines.

    Attributes:
        parts: Coefficients keyed by trigonometric product, then by monomial; a monomial is an
            integer with six bits per exponent.
        degree: Upper bound of the degree of the monomials.
    """

    parts: dict[TrigProduct, dict[int, Number]]
    degree: int

    @property
    def size(self) -> int:
        """Number of terms of the polynomial."""
        return sum(len(part) for part in self.parts.values())


class PolynomialRing:
    """Expansion of expressions into polynomials, with a table of symbols and caches.

    Attributes:
        symbols: Symbols, ordered by index in a monomial.
    """

    def __init__(
        self,
        groups: Iterable[Iterable[Factor]] = (),
        rounding: float = 0.0,
        budget: Budget | None = None,
    ) -> None:
        """Create a ring whose only symbols are the grouped angles.

        Args:
            groups: Groups of angles (coordinates, constants) that are added to each other.
            rounding: Coefficients up to this magnitude are set to zero.
            budget: Counter of terms and products.
        """
        self._rounding = rounding
        self._budget = budget or Budget()
        self.symbols: list[Factor] = []
        self._indices: dict[Factor, int] = {}
        self._expansions: dict[Factor, Polynomial] = {}
        self._product_cache: dict[tuple[TrigProduct, TrigProduct], TrigSum] = {}
        self._groups = {
            self._monomial(angle): number
            for number, group in enumerate(groups)
            for angle in group
        }

    def expand(self, value: Expression | Number) -> Polynomial:
        """Expand an expression into a polynomial.

        Args:
            value: The expression; its auxiliary variables and brackets are expanded, too.

        Raises:
            ExpressionError: The degree may exceed 63, there are too many terms, or a
                coefficient is too large.
        """
        # innermost factors first, to avoid deep recursion
        for factor in sorted_dependencies([expression(value)]):
            if factor.content is not None:
                self._factor(factor)
        total: dict[TrigProduct, dict[int, Number]] = {}
        degree = 0
        for factors, coefficient in expression(value).terms:
            symbols = [
                self._monomial(factor) for factor in factors if factor.content is None
            ]
            product = Polynomial({(): {sum(symbols): coefficient}}, len(symbols))
            for factor in factors:
                if factor.content is not None:
                    product = self.multiply(product, self._factor(factor))
            degree = max(degree, product.degree)
            for trig_product, part in product.parts.items():
                coefficients = total.setdefault(trig_product, {})
                for monomial, each in part.items():
                    coefficients[monomial] = coefficients.get(monomial, 0) + each
        return self._checked_polynomial(total, degree)

    def multiply(self, a: Polynomial, b: Polynomial) -> Polynomial:
        """Product of two polynomials of this ring."""
        total: dict[TrigProduct, dict[int, Number]] = {}
        for product_a, part_a in a.parts.items():
            for product_b, part_b in b.parts.items():
                trig_sum = self._multiply_products(product_a, product_b)
                self._budget.multiply(len(part_a) * len(part_b) * len(trig_sum))
                for trig_product, weight in trig_sum:
                    coefficients = total.setdefault(trig_product, {})
                    for m, u in part_a.items():
                        w = u * weight
                        for n, v in part_b.items():
                            key = m + n
                            coefficients[key] = coefficients.get(key, 0) + w * v
        return self._checked_polynomial(total, a.degree + b.degree)

    def exponents(self, monomial: int) -> list[tuple[Factor, int]]:
        """Symbols of a monomial with their exponents."""
        powers = []
        while monomial:
            position = (
                (monomial & -monomial).bit_length() - 1
            ) // EXPONENT_BITS  # of the lowest exponent that is not zero
            power = monomial >> (position * EXPONENT_BITS) & MAX_DEGREE
            powers.append((self.symbols[position], power))
            monomial ^= power << (position * EXPONENT_BITS)
        return powers

    def angle(self, number: int) -> Factor:
        """Symbol of an angle with a given number in a sine or cosine."""
        return self.exponents(number)[0][0]

    def _checked_polynomial(
        self, parts: dict[TrigProduct, dict[int, Number]], degree: int
    ) -> Polynomial:
        """Polynomial without negligible coefficients, after a check of degree and magnitude.

        Coefficients up to `rounding` in magnitude are negligible.

        Raises:
            ExpressionError: The degree exceeds 63, or the magnitude of a coefficient exceeds 1e150.
        """
        if degree > MAX_DEGREE:
            raise ExpressionError(
                f"an expression of degree {degree}; at most {MAX_DEGREE}"
            )
        tolerance = self._rounding
        for part in parts.values():
            for key in [
                key
                for key, coefficient in part.items()
                if -tolerance <= coefficient <= tolerance
            ]:
                del part[key]
            exact_number(max(part.values(), default=0))
            exact_number(min(part.values(), default=0))
        return Polynomial(
            {trig_product: part for trig_product, part in parts.items() if part}, degree
        )

    def _monomial(self, factor: Factor) -> int:
        """Monomial of a single symbol, which is added to the table if it is new."""
        index = self._indices.get(factor)
        if index is None:
            index = self._indices[factor] = len(self.symbols)
            self.symbols.append(factor)
        return 1 << (EXPONENT_BITS * index)

    def _factor(self, factor: Factor) -> Polynomial:
        """Expansion of a sine, cosine, bracket or auxiliary variable, cached."""
        expansion = self._expansions.get(factor)
        if expansion is None:
            assert factor.content is not None
            if factor.kind in (FactorKind.COSINE, FactorKind.SINE):
                expansion = self._trigonometric(factor.kind, factor.content)
            else:
                expansion = self.expand(factor.content)
            self._expansions[factor] = expansion
        return expansion

    def _trigonometric(self, nature: FactorKind, content: Expression) -> Polynomial:
        """Cosine or sine of a sum of angles, by expansion of exp(i angle)."""
        total: dict[TrigProduct, complex] = {(): 1.0}
        for group, index in sorted(self._angles(content).items()):
            sign, sine = _normalized(group, SINE, index)
            _, cosine = _normalized(group, COSINE, index)
            total = self._multiply_sums(total, {cosine: 1.0, sine: 1j * sign})
        sines = nature is FactorKind.SINE
        weights = {
            trig_product: (w.imag if sines else w.real)
            for trig_product, w in total.items()
        }
        return Polynomial(
            {
                trig_product: {0: weight}
                for trig_product, weight in weights.items()
                if weight
            },
            0,
        )

    def _multiply_sums(
        self, a: dict[TrigProduct, complex], b: dict[TrigProduct, complex]
    ) -> dict[TrigProduct, complex]:
        """Product of two sums of trigonometric products with complex weights."""
        products: dict[TrigProduct, complex] = {}
        for (x, u), (y, v) in choices(a.items(), b.items()):
            for trig_product, weight in self._multiply_products(x, y):
                products[trig_product] = (
                    products.get(trig_product, 0.0) + u * v * weight
                )
        return products

    def _angles(self, content: Expression) -> dict[int, AngleSum]:
        """Angle numbers and multiples of a sum of angles, keyed by group of angles.

        An angle outside of the groups forms a separate group with a negative number.
        """
        parts: dict[int, list[tuple[int, Number]]] = {}
        for trig_product, part in self.expand(content).parts.items():
            for monomial, number in part.items():
                angle_number = self._angle_number(trig_product, monomial)
                parts.setdefault(
                    self._groups.get(angle_number, -1 - angle_number), []
                ).append((angle_number, number))
        return {group: tuple(sorted(angle)) for group, angle in parts.items()}

    def _angle_number(self, trig_product: TrigProduct, monomial: int) -> int:
        """Number of an angle: the monomial of the angle or of a new symbol.

        A new symbol represents a term with sines or cosines.
        """
        if not trig_product:
            return monomial
        return self._monomial(
            Factor.interned(FactorKind.CONSTANT, f"angle {trig_product} {monomial}")
        )

    def _multiply_products(self, a: TrigProduct, b: TrigProduct) -> TrigSum:
        """Product of two trigonometric products as a weighted sum, cached."""
        if not a or not b:
            return ((a or b, 1.0),)
        result = self._product_cache.get((a, b))
        if result is None:
            result = self._product_cache[a, b] = self._expanded_product(a, b)
        return result

    def _expanded_product(self, a: TrigProduct, b: TrigProduct) -> TrigSum:
        """Product of two trigonometric products, multiplied out group by group."""
        left, right = (
            {trig_factor[0]: trig_factor for trig_factor in a},
            {trig_factor[0]: trig_factor for trig_factor in b},
        )
        options: list[list[tuple[TrigProduct, float]]] = []
        for group in sorted({*left, *right}):
            trig_factors = [each[group] for each in (left, right) if group in each]
            options.append(
                _product_in_group(group, *trig_factors)
                if len(trig_factors) > 1
                else [(tuple(trig_factors), 1.0)]
            )
        self._budget.multiply(prod(len(each) for each in options))
        trig_sum: dict[TrigProduct, float] = {}
        for choice in choices(*options):
            trig_product = tuple(
                trig_factor
                for trig_factors, _ in choice
                for trig_factor in trig_factors
            )
            trig_sum[trig_product] = trig_sum.get(trig_product, 0.0) + prod(
                share for _, share in choice
            )
        return tuple(
            (trig_product, weight)
            for trig_product, weight in trig_sum.items()
            if weight
        )
