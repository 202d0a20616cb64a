"""From expressions to lines that can be computed one after the other.

What the parameters and constants alone decide comes first, once for all samples; then the
sines and cosines; then the auxiliary variables; then the results.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from testbed.symbolic.expression import (
    Expression,
    Factor,
    Nature,
    Number,
    collect,
    depth_first,
    number,
    of,
    replaced,
)
from testbed.symbolic.optimise import Sheet, operations

Step: TypeAlias = tuple[Factor, Expression]
Values: TypeAlias = Mapping[Factor, float]


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
        symbols: Coordinates, parameters and constants that the lines use, in order.
        once: What parameters and constants alone decide.
        waves: Sines and cosines of coordinates.
        steps: Auxiliary variables, and each result as soon as it can be had; a result that
            is zero has no terms.
        results: Names of the results.
        count: Operations.
    """

    symbols: tuple[Factor, ...]
    once: tuple[Step, ...]
    waves: tuple[Factor, ...]
    steps: tuple[Step, ...]
    results: frozenset[Factor]
    count: Count

    @property
    def lines(self) -> Iterator[Step]:
        """All lines."""
        yield from self.once
        yield from self.steps


def recursive(results: Mapping[Factor, Expression]) -> Program:
    """Lines with auxiliary variables, and few operations.

    Args:
        results: What is asked for, by name.
    """
    sheet = Sheet(results)
    sheet.optimise()
    return _program(sheet, named=True)


def literal(results: Mapping[Factor, Expression]) -> Program:
    """Lines as they are written, without auxiliary variables.

    Args:
        results: What is asked for, by name, multiplied out; may refer to one another.
    """
    return _program(Sheet(results), named=False)


def with_numbers(program: Program, values: Values) -> Program:
    """The program with numbers in the place of constants.

    Args:
        program: Any.
        values: The constants.
    """
    known = dict(values)
    once = []
    for name, value in program.once:
        value = substituted(value, known)
        if all(not factors for factors, _ in value.terms):
            known[name] = float(value.terms[0][1]) if value.terms else 0.0
        else:
            once.append((name, value))
    steps = [(name, substituted(value, known)) for name, value in program.steps]
    return _counted(once, program.waves, steps, program.results)


def substituted(value: Expression, known: Values) -> Expression:
    """The expression with numbers for some of its factors, in its brackets too."""

    def meaning(factor: Factor) -> Expression | None:
        if factor.nature is Nature.BRACKET and factor.content is not None:
            return substituted(factor.content, known)
        return number(known[factor]) if factor in known else None

    return replaced(value, meaning)


def _program(sheet: Sheet, named: bool) -> Program:
    """Lines in order: brackets and products that serve once go where they are used."""
    uses = Counter(f for line in sheet.lines.values() for factors in line for f in factors)
    made: dict[Factor, Expression] = {}  # what to write in the place of a line's name
    once: list[Step] = []
    steps: list[Step] = []
    numbers: Counter[str] = Counter()
    for name in _computable(sheet):
        value = _snapped(replaced(collect(sheet.lines[name].items()), made.get))
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
    return _counted(once, _waves(sheet), steps, frozenset(sheet.results))


def _computable(sheet: Sheet) -> list[Factor]:
    """The sheet's lines, each after those it needs."""
    return depth_first(
        sheet.results,
        lambda name: [f for factors in sheet.lines[name] for f in factors if f in sheet.lines],
    )


def _snapped(value: Expression) -> Expression:
    """Numbers of the geometry that are small fractions but for rounding, as these."""
    if all(isinstance(size, int) for _, size in value.terms):
        return value
    return Expression(tuple((factors, _near(size)) for factors, size in value.terms))


def _near(size: Number) -> Number:
    near = round(size * 64) / 64
    exact = near if near and abs(size - near) < SNAP * abs(near) else size
    return int(exact) if exact == int(exact) else exact


SNAP = 4e-15
"""Relative distance from a fraction of 64 within which a number of the geometry is one."""


def _waves(sheet: Sheet) -> tuple[Factor, ...]:
    """Every sine and cosine in use, in order."""
    found = {
        factor
        for line in sheet.lines.values()
        for factors in line
        for factor in factors
        if factor.nature in (Nature.COSINE, Nature.SINE)
    }
    return tuple(sorted(found))


def _counted(
    once: Sequence[Step],
    waves: tuple[Factor, ...],
    steps: Sequence[Step],
    results: frozenset[Factor],
) -> Program:
    """The program with its symbols and operations."""
    symbols: set[Factor] = set()
    for value in [value for _, value in (*once, *steps)]:
        symbols |= {f for f in leaves(value) if f.nature <= Nature.CONSTANT}
    for wave in waves:
        if wave.content is not None:
            symbols |= set(leaves(wave.content))
    each = [cost(value) for _, value in steps]
    count = Count(
        sum(products for products, _ in each),
        sum(sums for _, sums in each),
        len(waves),
        sum(sum(cost(value)) for _, value in once),
    )
    return Program(tuple(sorted(symbols)), tuple(once), waves, tuple(steps), results, count)


def leaves(value: Expression) -> Iterator[Factor]:
    """Every factor of an expression and of its brackets."""
    for factors, _ in value.terms:
        for factor in factors:
            if factor.nature is Nature.BRACKET and factor.content is not None:
                yield from leaves(factor.content)
            else:
                yield factor


def cost(value: Expression) -> tuple[int, int]:
    """Multiplications and additions of an expression, its brackets included."""
    products, sums = operations(dict(value.terms))
    for factors, _ in value.terms:
        for factor in factors:
            if factor.nature is Nature.BRACKET and factor.content is not None:
                inner = cost(factor.content)
                products, sums = products + inner[0], sums + inner[1]
    return products, sums
