"""Listings of the paper and of other people, and the algebra by which they are compared."""

from __future__ import annotations

import math
import re
import resource
from fractions import Fraction
from operator import add, mul, sub

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.core.base.errors import ExpressionError, UnknownName
from testbed.equations.compare import compare_equations, read_listing
from testbed.equations.equations import FORMS, Form, equations
from testbed.equations.expression import (
    MAX_COEFFICIENT,
    Expression,
    FactorKind,
    cosine,
    expression,
    number,
    sine,
    symbol,
)
from testbed.equations.languages.latex import expression_line
from testbed.equations.polynomial import MAX_DEGREE, PolynomialRing
from testbed.equations.simplify import body_angles, simplify
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.strategies import few, trees

SECTIONS = dict(
    re.findall(r"\[(\w+)\]\n(.*?)(?=\n\[|\Z)", (GOLDEN / "equations.txt").read_text(), re.DOTALL)
)
COMPARABLE = ["joint-forces", "base-wrench", "mass-matrix", "gravity-forces"]


HALVES = "\n + Ks2d*qp1*qp2*S22 + K3d*qp1*qp2*S2233 + K3d*qp1*qp3*S2233\n"
"""What the paper's Q1 lacks with the sign that Table 6 gives K_d."""


def same(a: Expression | float, b: Expression | float) -> bool:
    """Whether two expressions are equal, whatever way they are written: exactly."""
    return not PolynomialRing().expand(expression(a) - expression(b)).parts


def terms(text: str) -> dict[str, list[tuple[str, list[str]]]]:
    """The terms of a listing's joint forces, their factors sorted."""
    lines = re.findall(r"^(Q\d) = (.*)", re.sub(r"\n(?=[ +-])", "", text), re.MULTILINE)
    parts = {name: re.findall("([+-]?)([^+-]+)", right.replace(" ", "")) for name, right in lines}
    return {name: sorted((x, sorted(y.split("*"))) for x, y in own) for name, own in parts.items()}


@pytest.mark.parametrize("form", ["full", "reduced"])
def test_the_papers_listing_term_by_term(form: Form, puma: tb.Tree) -> None:
    """[FRS96] 3.3 and 6.1: Q1, Q2, Q3, with products of sines and cosines as printed."""
    golden = SECTIONS[f"{form}_table1"]
    ours = tb.write_equations(equations(puma, ["joint-forces"], form, zeros=True), "paper")
    assert terms(ours) == terms(golden)
    assert len(terms(golden)["Q1"]) == {"full": 23, "reduced": 16}[form]
    found = compare_equations(puma, golden, form, zeros=True)
    assert set(found) == {"Q1", "Q2", "Q3"}
    assert not any(found.values())


def test_the_reaction_and_the_definitions_are_the_golden_ones(puma: tb.Tree) -> None:
    """The reaction in body 1's axes there, in the bedplate's here."""
    turned = (
        f"{ours}x = C1*{own}x - S1*{own}y\n{ours}y = S1*{own}x + C1*{own}y\n{ours}z = {own}z"
        for ours, own in (("F", "F1"), ("M", "L1"))
    )
    reaction = "\n".join([SECTIONS["reaction_table1"], *turned])
    definitions = SECTIONS["barycentric_table1"]
    for text, form, count in ((reaction, "reduced", 6), (definitions, "full", 21)):
        found = compare_equations(puma, text, form, zeros=True)  # type: ignore[arg-type]
        assert len(found) == count
        assert not any(found.values())


def test_the_printed_reduced_equation_lacks_a_factor_of_two(puma: tb.Tree) -> None:
    """With the sign that Table 6 gives K_d, only the three velocity terms differ."""
    printed, turned = (
        (ROOT / f"docs/listings/paper_reduced{end}.txt").read_text() for end in ("", "_sign")
    )
    for text, lacking in ((printed, 5), (turned, 3), (turned.rstrip() + HALVES, 0)):
        found = compare_equations(puma, text, "reduced", zeros=True)["Q1"].terms
        assert len(found) == lacking
        assert text is printed or all(size < 0 for _, size in found)  # too little


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
@given(tree=trees((1, 4)))
@few(3)
def test_its_own_listings_read_back_as_equal(form: Form, tree: tb.Tree) -> None:
    """To the last digit, oblique axes included: what is printed is what is computed."""
    text = tb.write_equations(equations(tree, COMPARABLE, form), "paper")
    parts = text.split("\n* ")[1:] if form == "recursive" else [text]
    for part in parts:  # auxiliary variables are each kind's own
        body = part.partition("\n")[2]
        if re.search(r"^\w+ =", body, re.MULTILINE):
            assert not any(compare_equations(tree, body, form).values())


def test_what_a_listing_or_a_request_may_not_say_is_named(puma: tb.Tree) -> None:
    """An equation that is another's would be compared with nothing, and called right."""
    own = tb.write_equations(equations(puma, form="reduced", zeros=True), "paper")
    for text, kind, culprit in (
        (own.replace("Q2", "Q4"), UnknownName, "'Q4'"),
        ("q1 = 0\nQ1 = q1", ExpressionError, "'q1'"),
        ("# nothing", ExpressionError, "equation"),
        ("K9 = 0", UnknownName, "'K9'"),
    ):
        with refuses(kind, culprit):
            compare_equations(puma, text, "reduced", zeros=True)
    with refuses(UnknownName, "'joint-force'", "'joint-forces'"):
        equations(puma, ["joint-force"])
    for wrong in (equations, lambda tree, form: compare_equations(tree, own, form)):
        with refuses(UnknownName, "'long'"):
            wrong(puma, form="long")  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_listing_takes_no_memory_without_end(puma: tb.Tree) -> None:
    """A small file from somebody else must not stop the machine."""
    squares = [f"a{k + 1} = a{k}*a{k} + q1" for k in range(39)]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for bomb in (
        "Q1 = " + "q1*" * 100_000 + "q1",
        "\n".join(["a0 = q1 + q2", *squares, "Q1 = a39"]),
        "Q1 = " + "*".join(["(q1 + q2 + q3 + qp1 + qp2)"] * 50),
    ):
        with refuses(ExpressionError):
            compare_equations(puma, bomb, zeros=True)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1_000_000


@pytest.mark.slow
def test_the_limit_of_terms_holds_and_changes_nothing_else() -> None:
    """Literal equations of twenty joints would take all memory; the option raises the limit."""
    tree = random_robot(np.random.default_rng(1), 3).tree()
    for form in ("reduced", "recursive"):
        whole = equations(tree, "joint-forces", form)
        least = sum(len(value.terms) for value in dict(whole.equations[0].program.steps).values())
        for most in (1, least // 2 - 1, 8000):
            try:
                found = equations(tree, "joint-forces", form, max_terms=most)
            except ExpressionError:
                assert most < 8000
            else:
                assert most > least / 2
                assert tb.write_equations(found, "python") == tb.write_equations(whole, "python")
    many = random_robot(np.random.default_rng(1), 20).tree()
    assert equations(many, "joint-forces", "recursive").equations
    with refuses(ExpressionError, "--max-terms", "recursive", " 10000 "):
        equations(many, "joint-forces", "reduced", max_terms=10_000)


NAMES = {
    name: symbol(nature, name, rank)
    for nature, names in (
        (FactorKind.ACCELERATION, ("qpp1", "qpp2")),
        (FactorKind.VELOCITY, ("qp1", "qp2")),
        (FactorKind.PARAMETER, ("K1zz", "mb2z")),
        (FactorKind.POSITION, ("q1", "q2", "q3")),
        (FactorKind.CONSTANT, ("l12z", "g")),
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


anything = st.recursive(
    leaves,
    lambda parts: st.builds(
        lambda how, a, b: expression(how(a, b)), st.sampled_from((add, sub, mul)), parts, parts
    ),
    max_leaves=8,
)
WAVES = {FactorKind.COSINE: math.cos, FactorKind.SINE: math.sin}


def value(e: Expression, at: dict[str, float]) -> float:
    """An expression's value: sums and products of floats, and nothing else of the algebra."""
    total = 0.0
    for factors, size in e.terms:
        product = float(size)
        for factor in factors:
            inside = at[factor.name] if factor.content is None else value(factor.content, at)
            product *= WAVES.get(factor.kind, float)(inside)
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
    ring = PolynomialRing([[f.terms[0][0][0] for f in Q]])
    natural = body_angles(ring, [*Q, Q[0] + Q[1], Q[1] + Q[2], Q[0] + Q[1] + Q[2]])
    written = simplify(ring, ring.expand(e), natural)
    at = somewhere(seed)
    assert value(written, at) == pytest.approx(value(e, at), rel=1e-9, abs=1e-9)
    assert same(written, e)
    plain = simplify(ring, ring.expand(e), frozenset())
    assert same(read_listing(f"Q1 = {expression_line(plain)}", NAMES)["Q1"], e)
    more = NAMES[name]
    for _ in range(power):
        more = expression(more * cosine(Q[0] + Q[1]))
    assert not same(e + more / 2**20, e)


@given(angles, angles)
def test_trigonometry_is_known(a: Expression, b: Expression) -> None:
    """Of one turn after another, and of halves: else a right listing would be called wrong."""

    def s(angle: Expression) -> Expression:
        return sine(angle) if angle else number(0)

    def c(angle: Expression) -> Expression:
        return cosine(angle) if angle else number(1)

    assert same(s(a + b), expression(s(a) * c(b)) + expression(c(a) * s(b)))
    assert same(c(a - b), expression(c(a) * c(b)) + expression(s(a) * s(b)))
    assert same(s(a), 2 * expression(s(a / 2) * c(a / 2)))


@given(st.integers(-200, 200), st.integers(0, 10))
def test_numbers_are_exact_and_written_as_people_do(over: int, shift: int) -> None:
    """1/2 and 3/4, not 0.5 and 0.75; binary fractions add without rounding."""
    size, wanted = over / 2**shift, Fraction(over, 2**shift)
    total = number(size) + number(size) * number(3)
    assert Fraction(total.terms[0][1] if total else 0) == wanted * 4
    value = expression(NAMES["g"] * size)
    text = expression_line(value)
    if wanted and wanted.denominator in (2, 4, 8, 16, 32, 64):
        assert text.lstrip("-") == f"{abs(wanted)}*g"
    assert read_listing(f"Q1 = {text}", NAMES)["Q1"] == value


NO_LISTING = {
    "K1zz": "NAME", "Q1 =": "NAME", "a b = g": "NAME", "Q1 = g*": "line 1",
    "\nQ1 = (g + qp1": "line 2", "Q1 = g g": "'g g'",
    "Q1 = g / qp1": "line 1", "Q1 = 1 / 0": "line 1", "Q1 = 1e999*g": "large",
    "Q1 = 1e100*1e100": "large", "Q1 = 1/1e-320": "line 1", "Q1 = " + "(" * 3000: "line 1",
    "Q1 = " + "-" * 100_000 + "g": "line 1", "Q1 = g ** 99": "20", "Q1 = g\nQ1 = g": "Q1",
    "Q1 = \u0663*g": "\u0663", "Q1 = __import__('os')": "'os'", "Q1 = g(g)": "g(g)",
    "Q1 = g if g else g": "line 1", "Q1 = True*g": "True",
    "Q1 = g / 'a'": "line 1",
    "Q1 = K9zz*qpp1": "K9zz", "Q1 = S_1_m9": "S_1_m9",
}  # fmt: skip


def test_what_is_no_listing_is_refused_with_its_line() -> None:
    """A file from somebody else is neither guessed at nor run."""
    for text, culprit in NO_LISTING.items():
        with refuses((ExpressionError, UnknownName), culprit):  # type: ignore[arg-type]
            read_listing(text, NAMES)


def test_signs_powers_and_angles_that_cancel_are_read() -> None:
    """Another equation than the one that somebody wrote would be called wrong."""
    g, q = NAMES["g"], NAMES["q1"]
    read = read_listing("Q1 = - -g\nQ2 = .5*g**2 -\t2*q1^3\ng = 7*q1", NAMES)
    assert read["Q1"] == g
    assert same(read["Q2"], expression(g * g) / 2 - 2 * expression(expression(q * q) * q))
    assert same(read_listing("Q1 = 3*S_1_m1 + 5*C_1_m1", NAMES)["Q1"], 5)
    many = read_listing(f"Q1 = ({' + '.join(['g'] * 20_000)})*1e-3 - 2.-1E+1", NAMES)["Q1"]
    assert same(many, expression(g * 20) - 12)


def test_numbers_up_to_the_largest_and_degrees_up_to_the_greatest_are_exact() -> None:
    """Beyond, an answer would be wrong without a word: it is refused."""
    x = NAMES["g"]
    for size in (MAX_COEFFICIENT, -MAX_COEFFICIENT, 1 / MAX_COEFFICIENT):
        assert x * size - x * size == number(0)
    for wrong in (MAX_COEFFICIENT * 1.01, float("nan")):
        with refuses(ExpressionError):
            x * wrong
    for one, other in ((31, 32), (0, 48), (63, 0)):
        product = math.prod([x] * one + [Q[0]] * other, start=expression(1))
        ring = PolynomialRing()
        assert simplify(ring, ring.expand(product), frozenset()) == product
        with refuses(ExpressionError, str(MAX_DEGREE)):
            same(math.prod([x] * (MAX_DEGREE + 1 - one - other), start=product), 0)
