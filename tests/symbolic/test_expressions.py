"""The algebra of expressions: laws on random ones, and numbers as the second witness."""

from __future__ import annotations

import gc
import math
import operator
import weakref
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testbed.errors import ExpressionError, UnknownName
from testbed.symbolic.expression import Expression, Factor, Nature, expression, number, symbol
from testbed.symbolic.languages.paper import line
from testbed.symbolic.parse import read_listing
from testbed.symbolic.polynomial import Ring, same
from testbed.symbolic.symbol_algebra import cosine, sine
from testbed.symbolic.tidy import natural_angles, present

NAMES = {
    name: symbol(nature, name, rank)
    for nature, names in (
        (Nature.ACCELERATION, ("qpp1", "qpp2")),
        (Nature.VELOCITY, ("qp1", "qp2")),
        (Nature.PARAMETER, ("K1zz", "mb2z")),
        (Nature.POSITION, ("q1", "q2", "q3")),
        (Nature.CONSTANT, ("l12z", "g")),
    )
    for rank, name in enumerate(names)
}
Q = [NAMES["q1"], NAMES["q2"], NAMES["q3"]]
angles = st.lists(st.integers(-2, 2), min_size=3, max_size=3).map(
    lambda times: sum((q * k for q, k in zip(Q, times, strict=True)), number(0))
)
leaves = st.one_of(
    st.sampled_from(sorted(NAMES)).map(NAMES.__getitem__),
    st.integers(-3, 3).map(number),
    angles.filter(bool).map(sine),
    angles.filter(bool).map(cosine),
)


def combine(children: st.SearchStrategy[Expression]) -> st.SearchStrategy[Expression]:
    pairs = st.tuples(children, children)
    return st.one_of(
        pairs.map(lambda ab: ab[0] + ab[1]),
        pairs.map(lambda ab: ab[0] - ab[1]),
        pairs.map(lambda ab: expression(ab[0] * ab[1])),
    )


anything = st.recursive(leaves, combine, max_leaves=8)


def value(e: Expression, at: dict[str, float]) -> float:
    """An expression's value: sums and products of floats, and nothing else of the algebra."""
    total = 0.0
    for factors, size in e.terms:
        product = float(size)
        for factor in factors:
            if factor.content is None:
                product *= at[factor.name]
            elif factor.nature is Nature.COSINE:
                product *= math.cos(value(factor.content, at))
            elif factor.nature is Nature.SINE:
                product *= math.sin(value(factor.content, at))
            else:
                product *= value(factor.content, at)
        total += product
    return total


def somewhere(seed: int) -> dict[str, float]:
    return {name: math.sin(7.3 * k + seed) for k, name in enumerate(sorted(NAMES), start=1)}


@pytest.mark.slow
@given(anything, anything, anything)
def test_the_laws_of_a_ring(a: Expression, b: Expression, c: Expression) -> None:
    assert a + b - a == b
    assert a - a == number(0)
    assert a + b == b + a
    assert (a + b) + c == a + (b + c)
    assert expression(a * b) == expression(b * a)
    assert same(expression((a + b) * c), expression(a * c) + expression(b * c))
    assert same(expression(expression(a * b) * c), expression(a * expression(b * c)))


@given(anything, anything, st.integers(0, 3))
def test_operations_are_those_of_numbers(a: Expression, b: Expression, seed: int) -> None:
    at = somewhere(seed)
    assert value(a + b, at) == pytest.approx(value(a, at) + value(b, at), abs=1e-9)
    product = value(a, at) * value(b, at)
    assert value(expression(a * b), at) == pytest.approx(product, rel=1e-9, abs=1e-9)


@given(anything, st.integers(0, 3))
def test_multiplied_out_and_written_anew_it_is_the_same(e: Expression, seed: int) -> None:
    ring = Ring([[f.terms[0][0][0] for f in Q]])
    natural = natural_angles(ring, [*Q, Q[0] + Q[1], Q[1] + Q[2], Q[0] + Q[1] + Q[2]])
    written = present(ring, ring.expand(e), natural)
    at = somewhere(seed)
    assert value(written, at) == pytest.approx(value(e, at), rel=1e-9, abs=1e-9)
    assert same(written, e)


@given(angles, angles)
def test_trigonometry_is_known(a: Expression, b: Expression) -> None:
    def s(angle: Expression) -> Expression:
        return sine(angle) if angle else number(0)

    def c(angle: Expression) -> Expression:
        return cosine(angle) if angle else number(1)

    assert same(expression(s(a) * s(a)) + expression(c(a) * c(a)), 1)
    assert same(s(a + b), expression(s(a) * c(b)) + expression(c(a) * s(b)))
    assert same(c(a + b), expression(c(a) * c(b)) - expression(s(a) * s(b)))
    assert same(s(a * 2), 2 * expression(s(a) * c(a)))
    assert same(c(-a), c(a))
    assert same(s(-a), -s(a))


@given(anything, st.sampled_from(sorted(NAMES)), st.integers(1, 5))
def test_what_differs_is_not_the_same(e: Expression, name: str, power: int) -> None:
    """The negative control: one more term, however small."""
    more = NAMES[name]
    for _ in range(power):
        more = expression(more * cosine(Q[0] + Q[1]))
    assert not same(e + more / 2**20, e)


@given(anything)
def test_a_listing_reads_back(e: Expression) -> None:
    ring = Ring([[f.terms[0][0][0] for f in Q]])
    written = present(ring, ring.expand(e), frozenset())
    read = read_listing(f"Q1 = {line(written)}", NAMES)["Q1"]
    assert same(read, written)


def test_a_sum_of_the_paper_cancels() -> None:
    """[FRS96] 3.2: x = a + b - a."""
    a, b = NAMES["g"], NAMES["l12z"]
    assert a + b - a == b
    assert repr(NAMES["g"] * sine(Q[0]) + NAMES["l12z"] * NAMES["qpp2"]) == "qpp2*l12z + g*S1"


def test_the_order_is_by_nature_then_by_name() -> None:
    """[FRS96] 3.2: cos(q1) < sin(q1) < (q2 + q3)."""
    bracketed = Q[0] * (Q[1] + Q[2])
    natures = [cosine(Q[0]), sine(Q[0]), bracketed]
    keys = [max(f.key for f in e.terms[0][0]) for e in natures]
    assert keys == sorted(keys)
    assert symbol(Nature.VELOCITY, "qp10", 9).terms > symbol(Nature.VELOCITY, "qp2", 1).terms


def test_expressions_are_values() -> None:
    e = NAMES["g"] * sine(Q[1])
    with pytest.raises(AttributeError, match="does not change"):
        e.terms = ()
    with pytest.raises(AttributeError, match="does not change"):
        e.terms[0][0][0].name = "h"
    assert sine(Q[1] + Q[2]).terms[0][0][0] is sine(Q[2] + Q[1]).terms[0][0][0]
    assert len({e, NAMES["g"] * sine(Q[1])}) == 1


def test_sums_that_differ_by_a_factor_share_a_bracket() -> None:
    a, b = NAMES["qp1"], NAMES["qp2"]
    brackets = {
        factor
        for e in (a + b, -a - b, 2 * a + 2 * b)
        for factor in (NAMES["g"] * e).terms[0][0]
        if factor.nature is Nature.BRACKET
    }
    assert len(brackets) == 1


def test_angles_that_are_expressions() -> None:
    """Sines of halves, of products and of sines have a normal form too."""
    q, p = Q[0], NAMES["l12z"]
    half = sine(q / 2)
    assert same(2 * half * cosine(q / 2), sine(q))
    assert same(sine(expression(p * (q + Q[1]))), sine(expression(p * q) + expression(p * Q[1])))
    nested = sine(sine(q) + cosine(q))
    assert same(
        nested, expression(sine(sine(q)) * cosine(cosine(q)))
        + expression(cosine(sine(q)) * sine(cosine(q)))
    )  # fmt: skip
    assert not same(nested, sine(sine(q)))


def test_a_degree_that_does_not_fit_is_refused() -> None:
    power = NAMES["g"]
    for _ in range(63):
        power = expression(power * NAMES["g"])
    with pytest.raises(ExpressionError, match="degree of 64|degree 64"):
        same(power, 0)


def test_a_hundred_thousand_terms_are_expanded() -> None:
    """(sum of 60 waves) (sum of 60) (sum of 30): every product of its own."""
    sums = []
    for letter, count in (("a", 60), ("b", 60), ("c", 30)):
        symbols = [symbol(Nature.PARAMETER, f"{letter}{k}", k) for k in range(count)]
        sums.append(sum((s * cosine(Q[k % 3]) for k, s in enumerate(symbols)), number(0)))
    a, b, c = sums
    assert Ring().expand(expression(a * b) * c).size == 192_000


@given(st.integers(-200, 200), st.integers(0, 20))
@settings(max_examples=30)
def test_numbers_are_exact(over: int, shift: int) -> None:
    """Binary fractions add without rounding: the witness are fractions."""
    size = over / 2**shift
    total = number(size) + number(size) * number(3)
    expected = Fraction(over, 2**shift) * 4
    assert Fraction(total.terms[0][1] if total else 0) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Q1 = g*", "line 1: 'the end' where a number or name"),
        ("\nQ1 = (g + qp1", "line 2: a bracket is not closed"),
        ("Q1 = g g", "line 1: 'g' where an operator"),
        ("Q1 = g / qp1", "line 1: a listing divides by numbers only"),
        ("Q1 = 1 / 0", "line 1: a listing divides by numbers only, and not by zero"),
        ("Q1 = 1e999*g", "line 1: the number 1e999 is too large"),
        ("Q1 = " + "(" * 3000, "line 1: brackets in more than 50 brackets"),
        ("Q1 = g ** 99", "line 1: an exponent is a number from 1 to 20"),
        ("Q1 = g\nQ1 = g", "line 2: Q1 is defined twice"),
        ("Q1 = ٣*g", "line 1: '٣.g' cannot be read"),
        ("hello", "line 1: NAME = expression"),
        ("Q1 = __import__('os')", "line 1: ''os'.' cannot be read"),
    ],
)
def test_what_is_no_listing_is_refused(text: str, message: str) -> None:
    with pytest.raises(ExpressionError, match=message):
        read_listing(text, NAMES)


def test_signs_powers_and_bare_decimals_are_read() -> None:
    g, q = NAMES["g"], NAMES["q1"]
    read = read_listing(f"Q1 = {'-' * 3000}g\nQ2 = .5*g**2 - 2*q1^3\ng = 7*q1", NAMES)
    assert read["Q1"] == g
    assert same(read["Q2"], expression(g * g) / 2 - 2 * expression(expression(q * q) * q))
    assert NAMES["g"] == g


@pytest.mark.parametrize("text", ["Q1 = K9zz*qpp1", "Q1 = S9", "Q1 = S_1_m9"])
def test_names_that_stand_for_nothing_are_refused(text: str) -> None:
    with pytest.raises(UnknownName):
        read_listing(text, NAMES)


@pytest.mark.slow
def test_factors_are_forgotten_when_nobody_needs_them() -> None:
    factor = Factor(Nature.CONSTANT, "only_here")
    assert factor is Factor(Nature.CONSTANT, "only_here")
    watched = weakref.ref(factor)
    del factor
    gc.collect()
    assert watched() is None


@pytest.mark.parametrize("powers", [(32, 0), (32, 1), (31, 32), (1, 33), (0, 48)])
def test_exponents_of_any_size_are_read_back(powers: tuple[int, int]) -> None:
    a, b = symbol(Nature.CONSTANT, "a"), symbol(Nature.CONSTANT, "b")
    ring = Ring()
    ring.expand(a + b)
    ((_, part),) = ring.expand(
        math.prod([a] * powers[0] + [b] * powers[1], start=expression(1))
    ).parts.items()
    ((monomial, size),) = part.items()
    assert size == 1
    wanted = {n: p for n, p in zip("ab", powers, strict=True) if p}
    assert {factor.name: power for factor, power in ring.exponents(monomial)} == wanted


def test_symbols_are_known_by_their_names_and_words_are_no_numbers() -> None:
    a = symbol(Nature.CONSTANT, "a")
    assert repr(a.terms[0][0][0]) == "a"
    other: Any = "b"
    for combined in (operator.add, operator.sub, operator.mul):
        with pytest.raises(TypeError):
            combined(a, other)
    with pytest.raises(TypeError):
        other + a


def test_angles_that_cancel_are_zero() -> None:
    read = read_listing("Q1 = 3*S_1_m1 + 5*C_1_m1", NAMES)
    assert same(read["Q1"], 5)
