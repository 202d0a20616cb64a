"""From expressions to lines that can be computed one after the other.

What the parameters and constants alone decide comes first, once for all samples; then the
sines and cosines; then the auxiliary variables; then the results.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

from testbed.symbolic.expression import (
    Expression,
    Factor,
    Nature,
    Number,
    collect,
    depth_first,
    exact,
    number,
    of,
    substitute,
)
from testbed.symbolic.optimise import Assignments

Step: TypeAlias = tuple[Factor, Expression]
Values: TypeAlias = Mapping[Factor, float]
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
        return tuple(sorted(f for f in used if f.nature in (Nature.COSINE, Nature.SINE)))

    @cached_property
    def symbols(self) -> tuple[Factor, ...]:
        """Coordinates, parameters and constants that the lines use, in order."""
        values = [value for _, value in self.lines]
        values += [wave.content for wave in self.waves if wave.content is not None]
        used = {factor for value in values for factor in leaves(value)}
        return tuple(sorted(factor for factor in used if factor.nature <= Nature.CONSTANT))

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
    return _program(sheet, named=True)


def literal(results: Mapping[Factor, Expression]) -> Program:
    """Lines as they are written, without auxiliary variables.

    Args:
        results: What is asked for, by name, multiplied out; may refer to one another.
    """
    return _program(Assignments(results), named=False)


def with_numbers(program: Program, values: Values) -> Program:
    """The program with numbers in the place of constants.

    Args:
        program: Any.
        values: The constants.
    """
    known = dict(values)
    once = []
    for name, value in program.once:
        value = with_values(value, known)
        if all(not factors for factors, _ in value.terms):
            known[name] = float(value.terms[0][1]) if value.terms else 0.0
        else:
            once.append((name, value))
    steps = [(name, with_values(value, known)) for name, value in program.steps]
    return Program(tuple(once), tuple(steps), program.results)


def with_values(value: Expression, known: Values) -> Expression:
    """The expression with numbers for some of its factors, in its brackets too."""

    def meaning(factor: Factor) -> Expression | None:
        if factor.nature is Nature.BRACKET and factor.content is not None:
            return with_values(factor.content, known)
        return number(known[factor]) if factor in known else None

    return substitute(value, meaning)


def _program(sheet: Assignments, named: bool) -> Program:
    """Lines in order: brackets and products that serve once go where they are used."""
    uses = Counter(f for line in sheet.lines.values() for factors in line for f in factors)
    made: dict[Factor, Expression] = {}  # what to write in the place of a line's name
    once: list[Step] = []
    steps: list[Step] = []
    numbers: Counter[str] = Counter()
    for name in depth_first(sheet.results, sheet.needs):
        value = _snap(substitute(collect(sheet.lines[name].items()), made.get))
        own = name.nature is Nature.AUXILIARY and not name.name.startswith("_")
        if name in sheet.results:
            made[name] = of(name) if value else value
            steps.append((name, value))
        elif (own and named) or uses[name] > 1 or sheet.fixed(name):
            letter = "k" if sheet.fixed(name) else "t"
            label = name.name
            if not own:
                numbers[letter] += 1
                label = f"{letter}{numbers[letter]}"
            shown = Factor(Nature.AUXILIARY, label)
            made[name] = of(shown)
            (once if sheet.fixed(name) else steps).append((shown, value))
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
            if factor.nature is Nature.BRACKET and factor.content is not None:
                yield from leaves(factor.content)
            else:
                yield factor


def cost(value: Expression) -> tuple[int, int]:
    """Multiplications and additions of an expression, its brackets included; signs are free."""
    products, sums = 0, max(0, len(value.terms) - 1)
    for factors, size in value.terms:
        products += len(factors) - 1 + (abs(size) != 1) if factors else 0
        for factor in factors:
            if factor.nature is Nature.BRACKET and factor.content is not None:
                inner = cost(factor.content)
                products, sums = products + inner[0], sums + inner[1]
    return products, sums
