"""The algebra of expressions: laws on random ones, and numbers as the second witness."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.errors import ExpressionError, UnknownName
from testbed.symbolic.expression import (
    LARGEST_NUMBER,
    Expression,
    Nature,
    expression,
    number,
    symbol,
)
from testbed.symbolic.languages.paper import line
from testbed.symbolic.parse import read_listing
from testbed.symbolic.polynomial import LARGEST, Ring, same
from testbed.symbolic.symbol_algebra import cosine, sine
from testbed.symbolic.tidy import natural_angles, present
from tests.helpers.refusals import refuses

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
@given(anything, anything, anything, st.integers(0, 3))
def test_the_laws_of_a_ring_and_the_values_of_numbers(
    a: Expression, b: Expression, c: Expression, seed: int
) -> None:
    """Equations are sums and products: one wrong and every listing is."""
    assert (a + b - a, a - a, a + b, (a + b) + c) == (b, number(0), b + a, a + (b + c))
    assert expression(a * b) == expression(b * a)
    assert same(expression((a + b) * c), expression(a * c) + expression(b * c))
    at = somewhere(seed)
    assert value(a + b, at) == pytest.approx(value(a, at) + value(b, at), abs=1e-9)
    product = value(a, at) * value(b, at)
    assert value(expression(a * b), at) == pytest.approx(product, rel=1e-9, abs=1e-9)


@given(anything, st.integers(0, 3), st.sampled_from(sorted(NAMES)), st.integers(1, 5))
def test_written_anew_or_read_back_it_is_the_same_and_one_more_term_is_not(
    e: Expression, seed: int, name: str, power: int
) -> None:
    """However small the term: a comparison that forgives would call a wrong listing right."""
    ring = Ring([[f.terms[0][0][0] for f in Q]])
    natural = natural_angles(ring, [*Q, Q[0] + Q[1], Q[1] + Q[2], Q[0] + Q[1] + Q[2]])
    written = present(ring, ring.expand(e), natural)
    at = somewhere(seed)
    assert value(written, at) == pytest.approx(value(e, at), rel=1e-9, abs=1e-9)
    assert same(written, e)
    plain = present(ring, ring.expand(e), frozenset())
    assert same(read_listing(f"Q1 = {line(plain)}", NAMES)["Q1"], e)
    more = NAMES[name]
    for _ in range(power):
        more = expression(more * cosine(Q[0] + Q[1]))
    assert not same(e + more / 2**20, e)


def test_sums_that_differ_by_a_factor_share_a_bracket() -> None:
    """Else what is computed once would be computed again and again in real time."""
    a, b = NAMES["qp1"], NAMES["qp2"]
    of_each = [(NAMES["g"] * e).terms[0][0] for e in (a + b, -a - b, 2 * a + 2 * b)]
    assert len({f for factors in of_each for f in factors if f.nature is Nature.BRACKET}) == 1


@given(st.integers(-200, 200), st.integers(0, 10))
def test_numbers_are_exact_and_written_as_people_do(over: int, shift: int) -> None:
    """1/2 and 3/4, not 0.5 and 0.75; binary fractions add without rounding."""
    size, wanted = over / 2**shift, Fraction(over, 2**shift)
    total = number(size) + number(size) * number(3)
    assert Fraction(total.terms[0][1] if total else 0) == wanted * 4
    value = expression(NAMES["g"] * size)
    text = line(value)
    if wanted and wanted.denominator in (2, 4, 8, 16, 32, 64):
        assert text.lstrip("-") == f"{abs(wanted)}*g"
    assert read_listing(f"Q1 = {text}", NAMES)["Q1"] == value


NO_LISTING = {
    "Q1 = g*": "line 1", "\nQ1 = (g + qp1": "line 2", "Q1 = g g": "'g'", "Q1 = g / qp1": "line 1",
    "Q1 = 1 / 0": "line 1", "Q1 = 1e999*g": "1e999", "Q1 = 1e100*1e100": "large",
    "Q1 = 1/1e-320": "line 1", "Q1 = " + "(" * 3000: "50", "Q1 = g ** 99": "20",
    "Q1 = g\nQ1 = g": "Q1", "Q1 = \u0663*g": "\u0663", "Q1 = __import__('os')": "'os'",
    "Q1 = K9zz*qpp1": "K9zz", "Q1 = S_1_m9": "S_1_m9",
    "Q1 = " + "*".join(["g"] * (LARGEST + 1)): str(LARGEST),
}  # fmt: skip


def test_what_is_no_listing_is_refused_with_its_line() -> None:
    """A file from somebody else is neither guessed at nor run."""
    for text, culprit in NO_LISTING.items():
        with refuses((ExpressionError, UnknownName), culprit):  # type: ignore[arg-type]
            read_listing(text, NAMES)


def test_signs_powers_and_angles_that_cancel_are_read() -> None:
    """Another equation than the one that somebody wrote would be called wrong."""
    g, q = NAMES["g"], NAMES["q1"]
    read = read_listing(f"Q1 = {'-' * 3000}g\nQ2 = .5*g**2 - 2*q1^3\ng = 7*q1", NAMES)
    assert read["Q1"] == g
    assert same(read["Q2"], expression(g * g) / 2 - 2 * expression(expression(q * q) * q))
    assert same(read_listing("Q1 = 3*S_1_m1 + 5*C_1_m1", NAMES)["Q1"], 5)


def test_numbers_up_to_the_largest_and_degrees_up_to_the_greatest_are_exact() -> None:
    """Beyond, an answer would be wrong without a word: it is refused."""
    x = NAMES["g"]
    for size in (LARGEST_NUMBER, -LARGEST_NUMBER, 1 / LARGEST_NUMBER):
        assert x * size - x * size == number(0)
    for wrong in (LARGEST_NUMBER * 1.01, float("nan")):
        with refuses(ExpressionError):
            x * wrong
    for one, other in ((31, 32), (0, 48), (63, 0)):
        product = math.prod([x] * one + [Q[0]] * other, start=expression(1))
        ring = Ring()
        assert present(ring, ring.expand(product), frozenset()) == product
        with refuses(ExpressionError, str(LARGEST)):
            same(math.prod([x] * (LARGEST + 1 - one - other), start=product), 0)
