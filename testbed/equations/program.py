"""Ordered programs of assignments that compute expressions with few operations.

Expressions in parameters and constants alone come first and are computed once for all samples;
sines and cosines, auxiliary variables and results follow.
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
    FactorKind,
    Factors,
    Number,
    collect,
    depth_first_order,
    exact_number,
    factor_expression,
    sorted_dependencies,
    substitute,
    symbol,
)

Assignment: TypeAlias = tuple[Factor, Expression]
SNAP_TOLERANCE = 4e-15
"""Relative distance within which a coefficient is rounded to a multiple of 1/64."""


@dataclass(frozen=True)
class OperationCount:
    """Operation counts of a program; sign changes are not counted.

    Attributes:
        multiplications: Number of multiplications per sample.
        additions: Number of additions and subtractions per sample.
        trigonometric: Number of sines and cosines per sample.
        once: Number of multiplications and additions of parameters and constants alone.
    """

    multiplications: int
    additions: int
    trigonometric: int
    once: int


@dataclass(frozen=True, eq=False)
class Program:
    """Sequence of assignments, each after the assignments it depends on.

    Attributes:
        once: Assignments that depend on parameters and constants alone.
        steps: Assignments of auxiliary variables and results; a zero result has no terms.
        results: Names of the results.
    """

    once: tuple[Assignment, ...]
    steps: tuple[Assignment, ...]
    results: frozenset[Factor]

    @property
    def lines(self) -> tuple[Assignment, ...]:
        """Assignments of the program: constant assignments first, then the steps per sample."""
        return self.once + self.steps

    @cached_property
    def sines_and_cosines(self) -> tuple[Factor, ...]:
        """Sines and cosines in the program, sorted."""
        used = {factor for _, value in self.lines for factor in leaf_factors(value)}
        return tuple(
            sorted(f for f in used if f.kind in (FactorKind.COSINE, FactorKind.SINE))
        )

    @cached_property
    def symbols(self) -> tuple[Factor, ...]:
        """Coordinates, parameters and constants in the program, sorted."""
        values = [value for _, value in self.lines]
        values += [
            wave.content for wave in self.sines_and_cosines if wave.content is not None
        ]
        used = {factor for value in values for factor in leaf_factors(value)}
        return tuple(
            sorted(factor for factor in used if factor.kind <= FactorKind.CONSTANT)
        )

    @cached_property
    def count(self) -> OperationCount:
        """Operation counts of the program."""
        each = [cost(value) for _, value in self.steps]
        return OperationCount(
            sum(products for products, _ in each),
            sum(sums for _, sums in each),
            len(self.sines_and_cosines),
            sum(sum(cost(value)) for _, value in self.once),
        )


def recursive_program(results: Mapping[Factor, Expression]) -> Program:
    """Program with auxiliary variables, optimised for few operations.

    Args:
        results: Expressions of the results, keyed by name.
    """
    assignments = Assignments(results)
    assignments.optimise()
    return _sorted_program(assignments)


def literal_program(results: Mapping[Factor, Expression]) -> Program:
    """Program of fully expanded expressions, without auxiliary variables.

    Args:
        results: Expanded expressions of the results, keyed by name; they may refer to other
            results.
    """
    return _sorted_program(Assignments(results))


def _sorted_program(assignments: Assignments) -> Program:
    """Program of assignments, sorted by dependencies; expressions used once are inlined.

    Named auxiliary variables, results and constant lines are not inlined. Lines without a name
    become k1, k2, ... if they are constant, else t1, t2, ...
    """
    uses = Counter(
        f
        for line in assignments.lines.values()
        for factors, _ in line.terms
        for f in factors
    )
    replacements: dict[
        Factor, Expression
    ] = {}  # expressions by the name of an assignment
    once: list[Assignment] = []
    steps: list[Assignment] = []
    counters: Counter[str] = Counter()
    for name in depth_first_order(assignments.results, assignments.dependencies):
        value = _with_rounded_coefficients(
            substitute(assignments.lines[name], replacements.get)
        )
        has_name = name.kind is FactorKind.AUXILIARY and not name.name.startswith("_")
        is_constant = assignments.is_constant(name)
        if name in assignments.results:
            replacements[name] = factor_expression(name) if value else value
            steps.append((name, value))
        elif has_name or uses[name] > 1 or is_constant:
            letter = "k" if is_constant else "t"
            counters[letter] += not has_name
            printed_name = name.name if has_name else f"{letter}{counters[letter]}"
            replacements[name] = symbol(FactorKind.AUXILIARY, printed_name)
            (once if is_constant else steps).append(
                (Factor.interned(FactorKind.AUXILIARY, printed_name), value)
            )
        else:
            replacements[name] = value
    return Program(tuple(once), tuple(steps), frozenset(assignments.results))


def _with_rounded_coefficients(value: Expression) -> Expression:
    """Expression with coefficients near multiples of 1/64 rounded to these multiples."""

    def round_coefficient(coefficient: Number) -> Number:
        rounded = round(coefficient * 64) / 64
        return exact_number(
            rounded
            if rounded and abs(coefficient - rounded) < SNAP_TOLERANCE * abs(rounded)
            else coefficient
        )

    return Expression(
        tuple(
            (factors, round_coefficient(coefficient))
            for factors, coefficient in value.terms
        )
    )


def leaf_factors(value: Expression) -> Iterator[Factor]:
    """Factors of an expression, including the factors inside brackets."""
    for factors, _ in value.terms:
        for factor in factors:
            if factor.bracket_content:
                yield from leaf_factors(factor.bracket_content)
            else:
                yield factor


def cost(value: Expression) -> tuple[int, int]:
    """Numbers of multiplications and additions of an expression, including its brackets."""
    products, sums = 0, max(0, len(value.terms) - 1)
    for factors, coefficient in value.terms:
        products += len(factors) - 1 + (abs(coefficient) != 1) if factors else 0
        for factor in factors:
            if factor.bracket_content:
                inner_cost = cost(factor.bracket_content)
                products, sums = products + inner_cost[0], sums + inner_cost[1]
    return products, sums


class Assignments:
    """Assignments of auxiliary variables, brackets and results, with optimisations.

    Attributes:
        lines: Expressions, keyed by name of auxiliary variable, bracket or result.
        results: Names of the results, in order.
    """

    def __init__(self, results: Mapping[Factor, Expression]) -> None:
        """Create assignments for results and the auxiliary variables and brackets in the results.

        Args:
            results: Expressions of the results, keyed by name.
        """
        self.lines = {
            each: each.content or ZERO for each in sorted_dependencies(results.values())
        }
        self.lines |= results
        self.results = dict.fromkeys(results)
        self._constant_cache: dict[Factor, bool] = {}
        self._new_lines = 0

    def optimise(self) -> None:
        """Merge equal lines and constants, share common products, factor out, and merge again.

        Further rounds bring no reduction in practice.
        """
        self.merge_lines()
        self.merge_constants()
        self.share_common_products()
        self.factor_out()
        self.merge_constants()
        self.share_common_products()

    def is_constant(self, factor: Factor) -> bool:
        """Test whether a factor depends on parameters and constants alone."""
        if factor not in self._constant_cache:
            value = self.lines.get(factor, factor.content)
            if value is None:
                is_constant = factor.kind in (FactorKind.PARAMETER, FactorKind.CONSTANT)
            else:
                is_constant = all(
                    self.is_constant(part)
                    for factors, _ in value.terms
                    for part in factors
                )
            self._constant_cache[factor] = is_constant
        return self._constant_cache[factor]

    def variable_lines(self) -> list[Factor]:
        """Names of the lines that depend on joint coordinates."""
        return [name for name in self.lines if not self.is_constant(name)]

    def dependencies(self, name: Factor) -> list[Factor]:
        """Names of the lines to which a line refers."""
        return [
            f
            for factors, _ in self.lines[name].terms
            for f in factors
            if f in self.lines
        ]

    def add_line(self, value: Expression) -> Factor:
        """Add a line for an expression and return the name of the line."""
        self._new_lines += 1
        name = Factor.interned(FactorKind.AUXILIARY, f"_{self._new_lines}")
        self.lines[name] = value
        return name

    def merge_lines(self) -> None:
        """Remove unused lines, and lines equal or opposite to another line or factor."""
        while replacements := self._redundant_lines():

            def replacement(factor: Factor) -> Expression | None:
                value = replacements.get(factor)
                return substitute(value, replacement) if value else value

            remaining = {
                name: value
                for name, value in self.lines.items()
                if name not in replacements
            }
            self.lines = {
                name: substitute(value, replacement)
                for name, value in remaining.items()
            }
            self._constant_cache.clear()
        needed = set(depth_first_order(self.results, self.dependencies))
        self.lines = {
            name: value for name, value in self.lines.items() if name in needed
        }

    def _redundant_lines(self) -> dict[Factor, Expression]:
        """Replacements of lines that need no operation or equal another line up to the sign."""
        first_names: dict[Expression, tuple[Factor, int]] = {}
        replacements: dict[Factor, Expression] = {}
        for name, value in self.lines.items():
            if name in self.results:
                continue
            if cost(value) == (0, 0):
                replacements[name] = value
                continue
            sign = 1 if value.terms[0][1] > 0 else -1
            first_name, first_sign = first_names.setdefault(value * sign, (name, sign))
            if first_name is not name:
                replacements[name] = factor_expression(first_name) * (sign * first_sign)
        return replacements

    def merge_constants(self) -> None:
        """Replace products of constant factors, or of a factor and a number, with new lines."""
        constant_lines: dict[Expression, Factor] = {}
        for name in self.variable_lines():
            terms = []
            for factors, coefficient in self.lines[name].terms:
                constants = tuple(
                    factor for factor in factors if self.is_constant(factor)
                )
                if constants and len(constants) + (abs(coefficient) != 1) > 1:
                    product = Expression(((constants, abs(coefficient)),))
                    if product not in constant_lines:
                        constant_lines[product] = self.add_line(product)
                    variables = [
                        factor for factor in factors if factor not in constants
                    ]
                    factors, coefficient = (
                        _sorted_factors([*variables, constant_lines[product]]),
                        1 if coefficient > 0 else -1,
                    )
                terms.append((factors, coefficient))
            self.lines[name] = collect(terms)
        self.merge_lines()

    def share_common_products(self) -> None:
        """Replace products of two factors in several terms with new lines, most frequent first."""
        while True:
            occurrences: dict[
                tuple[Factor, Factor], dict[tuple[Factor, Factors], None]
            ] = {}
            for name in self.variable_lines():
                for factors, _ in self.lines[name].terms:
                    for pair in combinations(factors, 2):
                        occurrences.setdefault(pair, {})[name, factors] = None
            repeated = [pair for pair, terms in occurrences.items() if len(terms) > 1]
            if not repeated:
                break
            for pair in sorted(repeated, key=lambda pair: -len(occurrences[pair])):
                self._share_product(pair, occurrences[pair])
        self.merge_lines()

    def _share_product(
        self, pair: tuple[Factor, Factor], places: Iterable[tuple[Factor, Factors]]
    ) -> None:
        """Replace a product with a new line, if it still occurs in several terms.

        Args:
            pair: The two factors of the product.
            places: Line name and factors of each term with the product.
        """
        occurrences = [
            (name, each)
            for name, each in places
            if each in dict(self.lines[name].terms)
        ]
        if len(occurrences) < 2:
            return
        products = (Expression(((pair, 1),)), Expression(((pair, -1),)))
        existing = (
            n
            for n, _ in occurrences
            if self.lines[n] in products and n not in self.results
        )
        product_name = next(existing, None) or self.add_line(products[0])
        sign = self.lines[product_name].terms[0][1]
        for name, factors in occurrences:
            if name is not product_name:
                terms = dict(self.lines[name].terms)
                coefficient = terms.pop(factors)
                remaining = _without_factor(_without_factor(factors, pair[0]), pair[1])
                shared = _sorted_factors((*remaining, product_name)), coefficient * sign
                self.lines[name] = collect([*terms.items(), shared])

    def factor_out(self) -> None:
        """Factor out common factors of the terms of each line."""
        for name in self.variable_lines():
            while (best := self._best_factor(self.lines[name])) is not None:
                terms = self.lines[name].terms
                inner = collect(
                    (_without_factor(each, best), coefficient)
                    for each, coefficient in terms
                    if best in each
                )
                other_terms = [
                    (each, coefficient)
                    for each, coefficient in terms
                    if best not in each
                ]
                self.lines[name] = collect(
                    [*other_terms, (_sorted_factors((best, self.add_line(inner))), 1)]
                )
        self.merge_lines()

    def _best_factor(self, value: Expression) -> Factor | None:
        """Common factor that saves the most operations; None if no factor occurs twice."""
        counts = Counter(
            factor for factors, _ in value.terms for factor in dict.fromkeys(factors)
        )
        best, largest_saving = None, (0, False)
        for factor, occurrences in counts.items():
            if occurrences < 2:
                continue
            inner = [
                _without_factor(each, factor)
                for each, _ in value.terms
                if factor in each
            ]
            is_constant = all(
                self.is_constant(part) for factors in inner for part in factors
            )
            saving = ((occurrences - 1) * (1 + is_constant), self.is_constant(factor))
            if saving > largest_saving:
                best, largest_saving = factor, saving
        return best


def _without_factor(factors: Factors, factor: Factor) -> Factors:
    """Factors without one occurrence of a factor."""
    index = factors.index(factor)
    return factors[:index] + factors[index + 1 :]


def _sorted_factors(factors: Iterable[Factor]) -> Factors:
    """Factors in sorted order."""
    return tuple(sorted(factors))
