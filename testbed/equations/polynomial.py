"""Expressions multiplied out: the normal form, in which equal ones are alike.

A monomial is one integer, six bits an exponent, so that monomials are multiplied by adding
integers. Beside it goes a wave, a product of cosines and sines. Angles fall into groups, such
as the joints whose axes are parallel. Of each group a wave has at most one cosine or sine, of
a sum of angles with numbers: products within a group become sums,
2 cos a cos b = cos(a - b) + cos(a + b). Waves that differ are linearly independent. Sums across
groups are expanded. Numbers are integers and binary fractions.
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
    Nature,
    Number,
    auxiliaries,
    exact,
    expression,
)

Index: TypeAlias = tuple[tuple[int, Number], ...]  # (angle, how many times), in order
# group, 0 for a cosine or 1 for a sine, its angle
Tone: TypeAlias = tuple[int, int, Index]
Wave: TypeAlias = tuple[Tone, ...]  # at most one tone a group, in order
Mixture: TypeAlias = tuple[tuple[Wave, float], ...]  # waves with their weights

COSINE, SINE = 0, 1
BITS = 6
LARGEST = (1 << BITS) - 1
"""Largest degree of a polynomial: no exponent can run over into the next."""


def _in_group(group: int, one: Tone, two: Tone) -> list[tuple[Wave, float]]:
    """The product of two tones of one group as a sum of two."""
    kind = SINE if one[1] != two[1] else COSINE
    parts = (
        (combine(one[2], two[2], -1), -0.5 if one[1] < two[1] else 0.5),
        (combine(one[2], two[2], 1), -0.5 if one[1] and two[1] else 0.5),
    )
    options = []
    for index, weight in parts:
        sign, wave = _normal(group, kind, index)
        options.append((wave, sign * weight))
    return options


def combine(a: Index, b: Index, sign: int) -> Index:
    """The sum or difference of two angles."""
    total = dict(a)
    for atom, times in b:
        total[atom] = total.get(atom, 0) + sign * times
    return tuple(sorted((atom, times) for atom, times in total.items() if times))


def _normal(group: int, kind: int, index: Index) -> tuple[float, Wave]:
    """Sign and wave of a tone: the first angle counts positively; cos 0 = 1, sin 0 = 0."""
    if not index:
        return (0.0 if kind == SINE else 1.0), ()
    sign, index = positive(index)
    return (sign if kind == SINE else 1.0), ((group, kind, index),)


def positive(index: Index) -> tuple[int, Index]:
    """The sign of an angle's first part, and the angle in which that is positive."""
    if index and index[0][1] < 0:
        return -1, tuple((atom, -times) for atom, times in index)
    return 1, index


@dataclass(frozen=True)
class Polynomial:
    """A sum of monomials times waves.

    Attributes:
        parts: wave -> monomial -> number.
        degree: Bound on the degree.
    """

    parts: dict[Wave, dict[int, Number]]
    degree: int

    @property
    def size(self) -> int:
        """Number of terms."""
        return sum(len(part) for part in self.parts.values())


class Ring:
    """Where expressions are multiplied out: numbers symbols, remembers what it has expanded.

    Attributes:
        symbols: By number.
    """

    def __init__(
        self,
        groups: Iterable[Iterable[Factor]] = (),
        rounding: float = 0.0,
        budget: Budget | None = None,
    ) -> None:
        """An empty ring.

        Args:
            groups: Angles (coordinates, constants) that appear in sums, group by group.
            rounding: Numbers smaller than this are the rounding of zero.
            budget: Counts what is multiplied.
        """
        self._rounding = rounding
        self._budget = budget or Budget()
        self.symbols: list[Factor] = []
        self._place: dict[Factor, int] = {}
        self._known: dict[Factor, Polynomial] = {}
        self._products: dict[tuple[Wave, Wave], Mixture] = {}
        self._group = {
            self._monomial(angle): number
            for number, group in enumerate(groups)
            for angle in group
        }

    def expand(self, value: Expression | Number) -> Polynomial:
        """An expression multiplied out.

        Args:
            value: Auxiliary variables and brackets are looked through.

        Raises:
            ExpressionError: Its degree may exceed 63, there are too many terms, or numbers
                that are no longer finite.
        """
        # the deepest first: no deep recursion
        for factor in auxiliaries([expression(value)]):
            if factor.content is not None:
                self._factor(factor)
        total: dict[Wave, dict[int, Number]] = {}
        degree = 0
        for factors, size in expression(value).terms:
            symbols = [
                self._monomial(factor) for factor in factors if factor.content is None
            ]
            product = Polynomial({(): {sum(symbols): size}}, len(symbols))
            for factor in factors:
                if factor.content is not None:
                    product = self.multiply(product, self._factor(factor))
            degree = max(degree, product.degree)
            for wave, part in product.parts.items():
                into = total.setdefault(wave, {})
                for monomial, each in part.items():
                    into[monomial] = into.get(monomial, 0) + each
        return self._clean(total, degree)

    def multiply(self, a: Polynomial, b: Polynomial) -> Polynomial:
        """The product of two polynomials of this ring."""
        total: dict[Wave, dict[int, Number]] = {}
        for wave_a, part_a in a.parts.items():
            for wave_b, part_b in b.parts.items():
                mixture = self._product(wave_a, wave_b)
                self._budget.multiply(len(part_a) * len(part_b) * len(mixture))
                for wave, weight in mixture:
                    into = total.setdefault(wave, {})
                    for m, u in part_a.items():
                        w = u * weight
                        for n, v in part_b.items():
                            key = m + n
                            into[key] = into.get(key, 0) + w * v
        return self._clean(total, a.degree + b.degree)

    def exponents(self, monomial: int) -> list[tuple[Factor, int]]:
        """The symbols of a monomial and their exponents."""
        found = []
        while monomial:
            place = (
                (monomial & -monomial).bit_length() - 1
            ) // BITS  # of the lowest one there
            power = monomial >> (place * BITS) & LARGEST
            found.append((self.symbols[place], power))
            monomial ^= power << (place * BITS)
        return found

    def angle(self, number: int) -> Factor:
        """The symbol that an angle's number in a wave stands for."""
        return self.exponents(number)[0][0]

    def _clean(self, parts: dict[Wave, dict[int, Number]], degree: int) -> Polynomial:
        """Without zeros, and with numbers that a further product leaves finite."""
        if degree > LARGEST:
            raise ExpressionError(
                f"an expression of degree {degree}; at most {LARGEST}"
            )
        least = self._rounding
        for part in parts.values():
            for key in [key for key, size in part.items() if -least <= size <= least]:
                del part[key]
            exact(max(part.values(), default=0))
            exact(min(part.values(), default=0))
        return Polynomial({wave: part for wave, part in parts.items() if part}, degree)

    def _monomial(self, factor: Factor) -> int:
        place = self._place.get(factor)
        if place is None:
            place = self._place[factor] = len(self.symbols)
            self.symbols.append(factor)
        return 1 << (BITS * place)

    def _factor(self, factor: Factor) -> Polynomial:
        known = self._known.get(factor)
        if known is None:
            assert factor.content is not None
            if factor.nature in (Nature.COSINE, Nature.SINE):
                known = self._trigonometric(factor.nature, factor.content)
            else:
                known = self.expand(factor.content)
            self._known[factor] = known
        return known

    def _trigonometric(self, nature: Nature, content: Expression) -> Polynomial:
        """Cosine or sine of a sum of angles: the real or imaginary part of exp(i angle)."""
        total: dict[Wave, complex] = {(): 1.0}
        for group, index in sorted(self._angles(content).items()):
            sign, sine = _normal(group, SINE, index)
            _, cosine = _normal(group, COSINE, index)
            total = self._times(total, {cosine: 1.0, sine: 1j * sign})
        sines = nature is Nature.SINE
        weights = {wave: (w.imag if sines else w.real) for wave, w in total.items()}
        return Polynomial(
            {wave: {0: weight} for wave, weight in weights.items() if weight}, 0
        )

    def _times(
        self, a: dict[Wave, complex], b: dict[Wave, complex]
    ) -> dict[Wave, complex]:
        """Two sums of waves multiplied."""
        products: dict[Wave, complex] = {}
        for (x, u), (y, v) in choices(a.items(), b.items()):
            for wave, weight in self._product(x, y):
                products[wave] = products.get(wave, 0.0) + u * v * weight
        return products

    def _angles(self, content: Expression) -> dict[int, Index]:
        """A sum of angles by group."""
        parts: dict[int, list[tuple[int, Number]]] = {}
        for wave, part in self.expand(content).parts.items():
            for monomial, number in part.items():
                atom = self._atom(wave, monomial)
                parts.setdefault(self._group.get(atom, -1 - atom), []).append(
                    (atom, number)
                )
        return {group: tuple(sorted(angle)) for group, angle in parts.items()}

    def _atom(self, wave: Wave, monomial: int) -> int:
        """The number of an angle: the monomial, or a symbol made for what has waves in it."""
        if not wave:
            return monomial
        return self._monomial(Factor.of(Nature.CONSTANT, f"angle {wave} {monomial}"))

    def _product(self, a: Wave, b: Wave) -> Mixture:
        """Two waves multiplied."""
        if not a or not b:
            return ((a or b, 1.0),)
        found = self._products.get((a, b))
        if found is None:
            found = self._products[a, b] = self._multiplied(a, b)
        return found

    def _multiplied(self, a: Wave, b: Wave) -> Mixture:
        left, right = {tone[0]: tone for tone in a}, {tone[0]: tone for tone in b}
        options: list[list[tuple[Wave, float]]] = []
        for group in sorted({*left, *right}):
            tones = [each[group] for each in (left, right) if group in each]
            options.append(
                _in_group(group, *tones) if len(tones) > 1 else [(tuple(tones), 1.0)]
            )
        self._budget.multiply(prod(len(each) for each in options))
        mixture: dict[Wave, float] = {}
        for choice in choices(*options):
            wave = tuple(tone for tones, _ in choice for tone in tones)
            mixture[wave] = mixture.get(wave, 0.0) + prod(share for _, share in choice)
        return tuple((wave, weight) for wave, weight in mixture.items() if weight)
