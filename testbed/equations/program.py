"""From expressions to lines that can be computed one after the other.

What the parameters and constants alone decide comes first, once for all samples; then the
sines and cosines; then the auxiliary variables; then the results.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import TypeAlias

from testbed.equations.expression import (
    ZERO,
    Expression,
    Factor,
    Factors,
    Nature,
    Number,
    auxiliaries,
    collect,
    depth_first,
    exact,
    of,
    substitute,
    symbol,
)

Step: TypeAlias = tuple[Factor, Expression]
SNAP = 4e-15
"""Relative distance from a fraction of 64 within which a number of the geometry is one."""


@dataclass(frozen=True)
class Count:
    """Operations of a program; signs are free.

    Attributes:
        multiplications: For each sample.
        additions: For each sample, subtractions among them.
        trigonometric: Sines and cosines for each sample.
        once: Multiplications and additions that parameters and constants alone decide.
    """

    multiplications: int
    additions: int
    trigonometric: int
    once: int


@dataclass(frozen=True, eq=False)
class Program:
    """Lines in an order in which they can be computed.

    Attributes:
        once: What parameters and constants alone decide.
        steps: Auxiliary variables, and each result as soon as it can be had; a result that
            is zero has no terms.
        results: Names of the results.
    """

    once: tuple[Step, ...]
    steps: tuple[Step, ...]
    results: frozenset[Factor]

    @property
    def lines(self) -> tuple[Step, ...]:
        """All lines."""
        return self.once + self.steps

    @cached_property
    def waves(self) -> tuple[Factor, ...]:
        """Sines and cosines of coordinates, in order."""
        used = {factor for _, value in self.lines for factor in leaves(value)}
        return tuple(
            sorted(f for f in used if f.nature in (Nature.COSINE, Nature.SINE))
        )

    @cached_property
    def symbols(self) -> tuple[Factor, ...]:
        """Coordinates, parameters and constants that the lines use, in order."""
        values = [value for _, value in self.lines]
        values += [wave.content for wave in self.waves if wave.content is not None]
        used = {factor for value in values for factor in leaves(value)}
        return tuple(
            sorted(factor for factor in used if factor.nature <= Nature.CONSTANT)
        )

    @cached_property
    def count(self) -> Count:
        """Operations."""
        each = [cost(value) for _, value in self.steps]
        return Count(
            sum(products for products, _ in each),
            sum(sums for _, sums in each),
            len(self.waves),
            sum(sum(cost(value)) for _, value in self.once),
        )


def recursive(results: Mapping[Factor, Expression]) -> Program:
    """Lines with auxiliary variables, and few operations.

    Args:
        results: What is asked for, by name.
    """
    sheet = Assignments(results)
    sheet.optimise()
    return _program(sheet)


def literal(results: Mapping[Factor, Expression]) -> Program:
    """Lines as they are written, without auxiliary variables.

    Args:
        results: What is asked for, by name, multiplied out; may refer to one another.
    """
    return _program(Assignments(results))


def _program(sheet: Assignments) -> Program:
    """Lines in order: brackets and products that serve once go where they are used."""
    uses = Counter(
        f for line in sheet.lines.values() for factors, _ in line.terms for f in factors
    )
    made: dict[Factor, Expression] = {}  # what to write in the place of a line's name
    once: list[Step] = []
    steps: list[Step] = []
    numbers: Counter[str] = Counter()
    for name in depth_first(sheet.results, sheet.needs):
        value = _snap(substitute(sheet.lines[name], made.get))
        own = name.nature is Nature.AUXILIARY and not name.name.startswith("_")
        fixed = sheet.fixed(name)
        if name in sheet.results:
            made[name] = of(name) if value else value
            steps.append((name, value))
        elif own or uses[name] > 1 or fixed:
            letter = "k" if fixed else "t"
            numbers[letter] += not own
            shown = name.name if own else f"{letter}{numbers[letter]}"
            made[name] = symbol(Nature.AUXILIARY, shown)
            (once if fixed else steps).append(
                (Factor.of(Nature.AUXILIARY, shown), value)
            )
        else:
            made[name] = value
    return Program(tuple(once), tuple(steps), frozenset(sheet.results))


def _snap(value: Expression) -> Expression:
    """Numbers of the geometry that are small fractions but for rounding, as these."""

    def snap(size: Number) -> Number:
        near = round(size * 64) / 64
        return exact(near if near and abs(size - near) < SNAP * abs(near) else size)

    return Expression(tuple((factors, snap(size)) for factors, size in value.terms))


def leaves(value: Expression) -> Iterator[Factor]:
    """Every factor of an expression and of its brackets."""
    for factors, _ in value.terms:
        for factor in factors:
            if factor.inside:
                yield from leaves(factor.inside)
            else:
                yield factor


def cost(value: Expression) -> tuple[int, int]:
    """Multiplications and additions of an expression, its brackets included; signs are free."""
    products, sums = 0, max(0, len(value.terms) - 1)
    for factors, size in value.terms:
        products += len(factors) - 1 + (abs(size) != 1) if factors else 0
        for factor in factors:
            if factor.inside:
                inner = cost(factor.inside)
                products, sums = products + inner[0], sums + inner[1]
    return products, sums


class Assignments:
    """Sums under names, and among them the results.

    Attributes:
        lines: What each auxiliary variable, bracket or result stands for.
        results: The lines that are asked for.
    """

    def __init__(self, results: Mapping[Factor, Expression]) -> None:
        """Args: results: By name; what they refer to gets lines of its own."""
        self.lines = {
            each: each.content or ZERO for each in auxiliaries(results.values())
        }
        self.lines |= results
        self.results = dict.fromkeys(results)
        self._fixed: dict[Factor, bool] = {}
        self._made = 0

    def optimise(self) -> None:
        """All that this module can do; more rounds of it were found to change nothing."""
        self.unify()
        self.gather_fixed()
        self.share_products()
        self.take_factors_out()
        self.gather_fixed()
        self.share_products()

    def fixed(self, factor: Factor) -> bool:
        """Whether a factor depends on parameters and constants alone."""
        if factor not in self._fixed:
            value = self.lines.get(factor, factor.content)
            if value is None:
                known = factor.nature in (Nature.PARAMETER, Nature.CONSTANT)
            else:
                known = all(
                    self.fixed(part) for factors, _ in value.terms for part in factors
                )
            self._fixed[factor] = known
        return self._fixed[factor]

    def variable_lines(self) -> list[Factor]:
        """Names of the lines that are not fixed."""
        return [name for name in self.lines if not self.fixed(name)]

    def needs(self, name: Factor) -> list[Factor]:
        """The lines that a line refers to."""
        return [
            f
            for factors, _ in self.lines[name].terms
            for f in factors
            if f in self.lines
        ]

    def new(self, value: Expression) -> Factor:
        """A new line, and its name."""
        self._made += 1
        name = Factor.of(Nature.AUXILIARY, f"_{self._made}")
        self.lines[name] = value
        return name

    def unify(self) -> None:
        """One line for all that are equal or opposite; none for those that only rename."""
        while other := self._superfluous():

            def meaning(factor: Factor) -> Expression | None:
                value = other.get(factor)
                return substitute(value, meaning) if value else value

            left = {
                name: value for name, value in self.lines.items() if name not in other
            }
            self.lines = {
                name: substitute(value, meaning) for name, value in left.items()
            }
            self._fixed.clear()
        needed = set(depth_first(self.results, self.needs))
        self.lines = {
            name: value for name, value in self.lines.items() if name in needed
        }

    def _superfluous(self) -> dict[Factor, Expression]:
        """Lines that are zero, another name for a factor, or another line up to its sign."""
        first: dict[Expression, tuple[Factor, int]] = {}
        other: dict[Factor, Expression] = {}
        for name, value in self.lines.items():
            if name in self.results:
                continue
            if cost(value) == (0, 0):
                other[name] = value
                continue
            sign = 1 if value.terms[0][1] > 0 else -1
            found, its = first.setdefault(value * sign, (name, sign))
            if found is not name:
                other[name] = of(found) * (sign * its)
        return other

    def gather_fixed(self) -> None:
        """Several fixed factors of a term, or one with a number, become one."""
        made: dict[Expression, Factor] = {}
        for name in self.variable_lines():
            terms = []
            for factors, weight in self.lines[name].terms:
                fixed = tuple(factor for factor in factors if self.fixed(factor))
                if fixed and len(fixed) + (abs(weight) != 1) > 1:
                    product = Expression(((fixed, abs(weight)),))
                    if product not in made:
                        made[product] = self.new(product)
                    rest = [factor for factor in factors if factor not in fixed]
                    factors, weight = (
                        _ordered([*rest, made[product]]),
                        1 if weight > 0 else -1,
                    )
                terms.append((factors, weight))
            self.lines[name] = collect(terms)
        self.unify()

    def share_products(self) -> None:
        """Two factors that stand together in several terms become one, the most frequent first."""
        while True:
            places: dict[tuple[Factor, Factor], dict[tuple[Factor, Factors], None]] = {}
            for name in self.variable_lines():
                for factors, _ in self.lines[name].terms:
                    for pair in combinations(factors, 2):
                        places.setdefault(pair, {})[name, factors] = None
            common = [pair for pair, found in places.items() if len(found) > 1]
            if not common:
                break
            for pair in sorted(common, key=lambda pair: -len(places[pair])):
                self._share(pair, places[pair])
        self.unify()

    def _share(
        self, pair: tuple[Factor, Factor], places: Iterable[tuple[Factor, Factors]]
    ) -> None:
        """A line for a pair of factors, where it still stands in several places."""
        there = [
            (name, each)
            for name, each in places
            if each in dict(self.lines[name].terms)
        ]
        if len(there) < 2:
            return
        alone = (Expression(((pair, 1),)), Expression(((pair, -1),)))
        own = (n for n, _ in there if self.lines[n] in alone and n not in self.results)
        new = next(own, None) or self.new(alone[0])
        sign = self.lines[new].terms[0][1]
        for name, factors in there:
            if name is not new:
                terms = dict(self.lines[name].terms)
                size = terms.pop(factors)
                rest = _without(_without(factors, pair[0]), pair[1])
                shared = _ordered((*rest, new)), size * sign
                self.lines[name] = collect([*terms.items(), shared])

    def take_factors_out(self) -> None:
        """A factor that several terms of a sum share leaves them in brackets."""
        for name in self.variable_lines():
            while (best := self._best_factor(self.lines[name])) is not None:
                terms = self.lines[name].terms
                inner = collect(
                    (_without(each, best), c) for each, c in terms if best in each
                )
                rest = [(each, c) for each, c in terms if best not in each]
                self.lines[name] = collect(
                    [*rest, (_ordered((best, self.new(inner))), 1)]
                )
        self.unify()

    def _best_factor(self, value: Expression) -> Factor | None:
        """The factor that saves the most operations, if any does."""
        count = Counter(
            factor for factors, _ in value.terms for factor in dict.fromkeys(factors)
        )
        best, most = None, (0, False)
        for factor, times in count.items():
            if times < 2:
                continue
            inner = [
                _without(each, factor) for each, _ in value.terms if factor in each
            ]
            free = all(self.fixed(part) for factors in inner for part in factors)
            saved = ((times - 1) * (1 + free), self.fixed(factor))
            if saved > most:
                best, most = factor, saved
        return best


def _without(factors: Factors, one: Factor) -> Factors:
    place = factors.index(one)
    return factors[:place] + factors[place + 1 :]


def _ordered(factors: Iterable[Factor]) -> Factors:
    return tuple(sorted(factors))
