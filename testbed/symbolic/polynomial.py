"""Expressions multiplied out: the form in which equal ones are alike.

A monomial is one integer, six bits an exponent, so that monomials are multiplied by adding
integers; the waves of `trigonometry` go beside it. Numbers are integers and binary fractions.
"""

from __future__ import annotations

from collections.abc import Iterable

from testbed.errors import ExpressionError
from testbed.symbolic.budget import Budget
from testbed.symbolic.expression import (
    Expression,
    Factor,
    Nature,
    Number,
    exact,
    expression,
)
from testbed.symbolic.traversal import in_order
from testbed.symbolic.trigonometry import COSINE, SINE, Waves

BITS = 6
LARGEST = (1 << BITS) - 1
"""Largest degree of a polynomial: no exponent can run over into the next."""


class Polynomial:
    """A sum of monomials times waves.

    Attributes:
        parts: wave -> monomial -> number.
        degree: Bound on the degree.
    """

    __slots__ = ("degree", "parts")

    def __init__(self, parts: dict[int, dict[int, Number]], degree: int) -> None:
        """Args: parts: As the attribute. degree: As the attribute."""
        self.parts = parts
        self.degree = degree

    @property
    def size(self) -> int:
        """Number of terms."""
        return sum(len(part) for part in self.parts.values())


class Ring:
    """Where expressions are multiplied out: numbers symbols, remembers what it has expanded.

    Attributes:
        symbols: By number.
        waves: The waves of this ring.
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
        together = {
            self._monomial(angle): number for number, group in enumerate(groups) for angle in group
        }
        self.waves = Waves(together, self._budget)

    def expand(self, value: Expression | Number) -> Polynomial:
        """An expression multiplied out.

        Args:
            value: Auxiliary variables and brackets are looked through.

        Raises:
            ExpressionError: Its degree may exceed 63, there are too many terms, or numbers
                that are no longer finite.
        """
        for factor in in_order([expression(value)]):  # the deepest first: no deep recursion
            if factor.content is not None:
                self._factor(factor)
        total: dict[int, dict[int, Number]] = {}
        degree = 0
        for factors, size in expression(value).terms:
            monomial, plain = 0, 0
            product = Polynomial({0: {0: size}}, 0)
            for factor in factors:
                if factor.content is None:
                    monomial += self._monomial(factor)
                    plain += 1
                else:
                    product = self.multiply(product, self._factor(factor))
            degree = max(degree, product.degree + plain)
            for wave, part in product.parts.items():
                if not monomial and wave not in total:
                    total[wave] = part
                    continue
                into = total.setdefault(wave, {})
                for exponents, each in part.items():
                    key = exponents + monomial
                    into[key] = into.get(key, 0) + each
        return self._clean(total, degree)

    def multiply(self, a: Polynomial, b: Polynomial) -> Polynomial:
        """The product of two polynomials of this ring."""
        total: dict[int, dict[int, Number]] = {}
        for wave_a, part_a in a.parts.items():
            for wave_b, part_b in b.parts.items():
                mixture = self.waves.product(wave_a, wave_b)
                self._budget.multiply(len(part_a) * len(part_b) * len(mixture))
                for wave, weight in mixture:
                    into = total.setdefault(wave, {})
                    get = into.get
                    for m, u in part_a.items():
                        w = u * weight
                        for n, v in part_b.items():
                            key = m + n
                            into[key] = get(key, 0) + w * v
        return self._clean(total, a.degree + b.degree)

    def exponents(self, monomial: int) -> list[tuple[Factor, int]]:
        """The symbols of a monomial and their exponents."""
        found = []
        while monomial:
            place = ((monomial & -monomial).bit_length() - 1) // BITS  # of the lowest one there
            power = monomial >> (place * BITS) & LARGEST
            found.append((self.symbols[place], power))
            monomial ^= power << (place * BITS)
        return found

    def angle(self, number: int) -> Factor:
        """The symbol that an angle's number in a wave stands for."""
        return self.exponents(number)[0][0]

    def _clean(self, parts: dict[int, dict[int, Number]], degree: int) -> Polynomial:
        """Without zeros, and with numbers that a further product leaves finite."""
        if degree > LARGEST:
            raise ExpressionError(f"an expression of degree {degree}; at most {LARGEST}")
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
        angle = self.expand(content)
        atoms = [
            (self._atom(wave, monomial), number)
            for wave, part in angle.parts.items()
            for monomial, number in part.items()
        ]
        kind = SINE if nature is Nature.SINE else COSINE
        mixture = self.waves.tone(kind, atoms)
        return Polynomial({wave: {0: weight} for wave, weight in mixture}, 0)

    def _atom(self, wave: int, monomial: int) -> int:
        """The number of an angle: the monomial, or a symbol made for what has waves in it."""
        if wave == 0:
            return monomial
        name = f"angle {wave} {monomial}"
        return self._monomial(Factor(Nature.CONSTANT, name))


def same(a: Expression | Number, b: Expression | Number) -> bool:
    """Whether two expressions are equal, whatever way they are written.

    Exact: numbers are taken as the binary fractions they are.

    Args:
        a: An expression.
        b: Another one.
    """
    ring = Ring()
    return not ring.expand(expression(a) - expression(b)).parts
