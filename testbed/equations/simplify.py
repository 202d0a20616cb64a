"""Short form of a polynomial by product formulas of trigonometry, as in [FRS96].

For example, the short form of (C3 - C223)/2 is S2*S23. The normal form of `polynomial` has one
cosine or sine per group of parallel joints. Two such terms with coefficients of equal magnitude
become one product if both of its angles are angles between bodies; half the sine of a double angle
becomes a product of sine and cosine.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

from testbed.equations.expression import Expression, Number, Term, collect, cosine, sine
from testbed.equations.polynomial import (
    COSINE,
    SINE,
    AngleSum,
    Polynomial,
    PolynomialRing,
    combine,
    split_sign,
)

TrigFactor: TypeAlias = tuple[int, AngleSum]  # COSINE or SINE, angle
GroupProduct: TypeAlias = tuple[TrigFactor, ...]  # cosines and sines of one group
GroupProducts: TypeAlias = tuple[tuple[int, GroupProduct], ...]  # product of each group
TermKey: TypeAlias = tuple[
    int, GroupProducts
]  # monomial, products of sines and cosines
Terms: TypeAlias = dict[TermKey, Number]


def simplify(
    ring: PolynomialRing, polynomial: Polynomial, allowed_angles: frozenset[AngleSum]
) -> Expression:
    """Convert a polynomial into a short expression by product formulas.

    In each group of angles, two sines or two cosines with coefficients of equal magnitude become
    one product if both of its angles are allowed.

    Args:
        ring: Ring of the polynomial.
        polynomial: The polynomial.
        allowed_angles: Angles that are allowed in products, in the ring's angle numbers.
    """
    terms: Terms = {}
    for trig_product, part in polynomial.parts.items():
        products = tuple(
            (group, ((kind, index),)) for group, kind, index in trig_product
        )
        terms |= {(monomial, products): number for monomial, number in part.items()}
    for group in sorted(
        {group for trig_product in polynomial.parts for group, _, _ in trig_product}
    ):
        terms = _with_products(terms, group, allowed_angles)
    return collect(_term(ring, *key, number) for key, number in terms.items())


def body_angles(
    ring: PolynomialRing, angles: Iterable[Expression]
) -> frozenset[AngleSum]:
    """Angle sums in the numbering of a ring: sorted pairs of angle number and multiple.

    The sign of each sum is chosen so that the first multiple is positive.

    Args:
        ring: Ring that numbers the angles.
        angles: Integer combinations of joint coordinates.
    """
    indices = set()
    for angle in angles:
        terms = ring.expand(angle).parts.get((), {})
        index = tuple(
            sorted(
                (angle_number, int(multiple))
                for angle_number, multiple in terms.items()
            )
        )
        indices.add(split_sign(index)[1])
    return frozenset(indices)


def _with_products(terms: Terms, group: int, natural: frozenset[AngleSum]) -> Terms:
    """Terms with pairs of sines or cosines of one group replaced with products.

    Args:
        terms: Coefficients, keyed by monomial and product of sines and cosines.
        group: Number of the group of angles.
        natural: Angles that are allowed in products.
    """
    groups: dict[TermKey, dict[GroupProduct, Number]] = {}
    for (monomial, products), number in terms.items():
        rest = dict(products)
        product = rest.pop(group, ())
        groups.setdefault((monomial, tuple(rest.items())), {})[product] = number
    result: Terms = {}
    for (monomial, other_products), coefficients in groups.items():
        for product, number in _paired_terms(coefficients, natural).items():
            own_product = ((group, product),) if product else ()
            result[monomial, (*other_products, *own_product)] = number
    return result


def _paired_terms(
    coefficients: dict[GroupProduct, Number], natural: frozenset[AngleSum]
) -> dict[GroupProduct, Number]:
    """Replace sums of two sines or cosines with products where the angles allow it.

    Args:
        coefficients: Coefficients of the sines and cosines of one group, for one monomial.
        natural: Angles that are allowed in products.
    """
    remaining = dict(sorted(coefficients.items()))
    products: dict[GroupProduct, Number] = {}
    while remaining:
        first = next(iter(remaining))
        coefficient = remaining.pop(first)
        pair_product = None
        for second, second_coefficient in remaining.items():
            if abs(second_coefficient) == abs(coefficient):
                pair_product = _sum_as_product(
                    first, second, coefficient, second_coefficient, natural
                )
            if pair_product:
                del remaining[second]
                break
        product, new_coefficient = pair_product or _double_angle_product(
            first, coefficient, natural
        )
        products[product] = products.get(product, 0) + new_coefficient
    return {
        product: coefficient for product, coefficient in products.items() if coefficient
    }


def _sum_as_product(
    first: GroupProduct,
    second: GroupProduct,
    coefficient: Number,
    second_coefficient: Number,
    natural: frozenset[AngleSum],
) -> tuple[GroupProduct, Number] | None:
    """Product equal to a sum of two sines or of two cosines, and its coefficient.

    The result is None if the sum is of a sine and a cosine, or if an angle of the product is not
    allowed.

    Args:
        first: First sine or cosine.
        second: Second sine or cosine.
        coefficient: Coefficient of the first.
        second_coefficient: Coefficient of the second, of the same magnitude.
        natural: Angles that are allowed in products.
    """
    (kind, u), (second_kind, v) = _single_factor(first), _single_factor(second)
    half_sum, half_difference = (
        _half_angle(combine(u, v, 1)),
        _half_angle(combine(u, v, -1)),
    )
    if (
        kind != second_kind
        or half_sum is None
        or half_difference is None
        or (kind == SINE and not (u and v))
    ):
        return None
    same_sign = (coefficient > 0) == (second_coefficient > 0)
    # with h = (u + v) / 2, d = (u - v) / 2
    if kind == COSINE:  # cos u + cos v = 2 cos h cos d; cos u - cos v = -2 sin h sin d
        kinds = (COSINE, COSINE) if same_sign else (SINE, SINE)
        coefficient = coefficient if same_sign else -coefficient
    else:  # sin u + sin v = 2 sin h cos d; sin u - sin v = 2 cos h sin d
        kinds = (SINE, COSINE) if same_sign else (COSINE, SINE)
    factors = []
    for factor_kind, angle in zip(kinds, (half_sum, half_difference), strict=True):
        sign, angle = split_sign(angle)
        if angle not in natural:
            return None
        coefficient = coefficient * sign if factor_kind == SINE else coefficient
        factors.append((factor_kind, angle))
    return tuple(sorted(factors)), 2 * coefficient


def _double_angle_product(
    product: GroupProduct, number: Number, natural: frozenset[AngleSum]
) -> tuple[GroupProduct, Number]:
    """Product of sine and cosine for the sine of a double angle with half-integer coefficient.

    Other products, and angles whose half is not allowed, are returned unchanged.
    """
    kind, index = _single_factor(product)
    half = _half_angle(index)
    if len(product) == 1 and kind == SINE and half in natural and number % 1 == 0.5:
        return ((COSINE, half), (SINE, half)), 2 * number
    return product, number


def _single_factor(product: GroupProduct) -> TrigFactor:
    """Kind and angle of a single sine or cosine.

    An empty product is the cosine of zero.
    """
    return product[0] if product else (COSINE, ())


def _half_angle(index: AngleSum) -> AngleSum | None:
    """Half of an angle; None if a multiple is odd."""
    if any(times % 2 for _, times in index):
        return None
    return tuple((atom, int(times) // 2) for atom, times in index)


def _term(
    ring: PolynomialRing, monomial: int, products: GroupProducts, number: Number
) -> Term:
    """Term of an expression: a number times a monomial times products of sines and cosines.

    Args:
        ring: Ring of the polynomial.
        monomial: Number that encodes the exponents of the ring's atoms.
        products: Sine and cosine factors, by group of parallel angles.
        number: Coefficient.
    """
    factors = [
        factor for factor, power in ring.exponents(monomial) for _ in range(power)
    ]
    for _, product in products:
        for kind, index in product:
            angle = collect(((ring.angle(atom),), times) for atom, times in index)
            ((inside, sign),) = (sine if kind == SINE else cosine)(angle).terms
            factors += inside
            number *= sign
    return tuple(sorted(factors)), number if number != int(number) else int(number)
