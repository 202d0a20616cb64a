"""A polynomial as one would write it: S2*S23 for (C3 - C223)/2, S22 for 2*S2*C2.

The normal form of `polynomial` has one cosine or sine a group of parallel joints. Two of
them with numbers of equal size become one product where both of its angles are angles
between bodies; half a sine of a double angle becomes a product. This is how the listing
of [FRS96] is written.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

from testbed.equations.expression import Expression, Number, Term, collect, cosine, sine
from testbed.equations.polynomial import (
    COSINE,
    SINE,
    Index,
    Polynomial,
    Ring,
    combine,
    positive,
)

Tone: TypeAlias = tuple[int, Index]  # 0 for a cosine or 1 for a sine, its angle
Shape: TypeAlias = tuple[Tone, ...]  # cosines and sines of one group
Shapes: TypeAlias = tuple[tuple[int, Shape], ...]  # by group
Key: TypeAlias = tuple[int, Shapes]  # monomial, shapes
Terms: TypeAlias = dict[Key, Number]


def simplify(
    ring: Ring, polynomial: Polynomial, natural: frozenset[Index]
) -> Expression:
    """The polynomial as an expression.

    Args:
        ring: The polynomial's.
        polynomial: What to write.
        natural: Angles that products may have, in the ring's numbers.
    """
    terms: Terms = {}
    for wave, part in polynomial.parts.items():
        shapes = tuple((group, ((kind, index),)) for group, kind, index in wave)
        terms |= {(monomial, shapes): number for monomial, number in part.items()}
    for group in sorted({group for wave in polynomial.parts for group, _, _ in wave}):
        terms = _paired(terms, group, natural)
    return collect(_term(ring, *key, number) for key, number in terms.items())


def natural_angles(ring: Ring, angles: Iterable[Expression]) -> frozenset[Index]:
    """Angles in the ring's numbers, each with its first part positive."""
    found = set()
    for angle in angles:
        terms = ring.expand(angle).parts.get((), {})
        index = tuple(sorted((atom, int(times)) for atom, times in terms.items()))
        found.add(positive(index)[1])
    return frozenset(found)


def _paired(terms: Terms, group: int, natural: frozenset[Index]) -> Terms:
    """Terms with pairs of tones of one group as products."""
    alike: dict[Key, dict[Shape, Number]] = {}
    for (monomial, shapes), number in terms.items():
        rest = dict(shapes)
        shape = rest.pop(group, ())
        alike.setdefault((monomial, tuple(rest.items())), {})[shape] = number
    found: Terms = {}
    for (monomial, others), tones in alike.items():
        for shape, number in _products(tones, natural).items():
            own = ((group, shape),) if shape else ()
            found[monomial, (*others, *own)] = number
    return found


def _products(
    tones: dict[Shape, Number], natural: frozenset[Index]
) -> dict[Shape, Number]:
    """The tones of one term, pairs of them as products where that is shorter."""
    left = dict(sorted(tones.items()))
    found: dict[Shape, Number] = {}
    while left:
        one = next(iter(left))
        number = left.pop(one)
        made = None
        for two, other in left.items():
            if abs(other) == abs(number):
                made = _product(one, two, number, other, natural)
            if made:
                del left[two]
                break
        shape, size = made or _halved(one, number, natural)
        found[shape] = found.get(shape, 0) + size
    return {shape: number for shape, number in found.items() if number}


def _product(
    one: Shape, two: Shape, size: Number, other: Number, natural: frozenset[Index]
) -> tuple[Shape, Number] | None:
    """Two tones of one kind and with numbers of one size as a product, if it is natural."""
    (kind, u), (second, v) = _tone(one), _tone(two)
    half, rest = _half(combine(u, v, 1)), _half(combine(u, v, -1))
    if (
        kind != second
        or half is None
        or rest is None
        or (kind == SINE and not (u and v))
    ):
        return None
    alike = (size > 0) == (other > 0)
    if kind == COSINE:  # cos u + cos v = 2 cos h cos r; cos u - cos v = -2 sin h sin r
        kinds = (COSINE, COSINE) if alike else (SINE, SINE)
        size = size if alike else -size
    else:  # sin u + sin v = 2 sin h cos r; sin u - sin v = 2 cos h sin r
        kinds = (SINE, COSINE) if alike else (COSINE, SINE)
    shape = []
    for each, angle in zip(kinds, (half, rest), strict=True):
        sign, angle = positive(angle)
        if angle not in natural:
            return None
        size = size * sign if each == SINE else size
        shape.append((each, angle))
    return tuple(sorted(shape)), 2 * size


def _halved(
    shape: Shape, number: Number, natural: frozenset[Index]
) -> tuple[Shape, Number]:
    """Half a sine of a double angle as a sine times a cosine."""
    kind, index = _tone(shape)
    half = _half(index)
    if len(shape) == 1 and kind == SINE and half in natural and number % 1 == 0.5:
        return ((COSINE, half), (SINE, half)), 2 * number
    return shape, number


def _tone(shape: Shape) -> Tone:
    """Kind and angle of a single tone; 1 is the cosine of nothing."""
    return shape[0] if shape else (COSINE, ())


def _half(index: Index) -> Index | None:
    """Half an angle, if its parts stay whole."""
    if any(times % 2 for _, times in index):
        return None
    return tuple((atom, int(times) // 2) for atom, times in index)


def _term(ring: Ring, monomial: int, shapes: Shapes, number: Number) -> Term:
    factors = [
        factor for factor, power in ring.exponents(monomial) for _ in range(power)
    ]
    for _, shape in shapes:
        for kind, index in shape:
            angle = collect(((ring.angle(atom),), times) for atom, times in index)
            ((inside, sign),) = (sine if kind == SINE else cosine)(angle).terms
            factors += inside
            number *= sign
    return tuple(sorted(factors)), number if number != int(number) else int(number)
