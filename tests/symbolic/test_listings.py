"""Listings of the paper and of other people, against the robot's own equations, term by term."""

from __future__ import annotations

import re
import resource

import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.errors import ExpressionError, UnknownName
from testbed.symbolic.compare import compare_equations
from testbed.symbolic.equations import FORMS, Form, equations
from testbed.symbolic.languages import write_equations
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


def terms(text: str) -> dict[str, list[tuple[str, list[str]]]]:
    """The terms of a listing's joint forces, their factors sorted."""
    lines = re.findall(r"^(Q\d) = (.*)", re.sub(r"\n(?=[ +-])", "", text), re.MULTILINE)
    parts = {name: re.findall("([+-]?)([^+-]+)", right.replace(" ", "")) for name, right in lines}
    return {name: sorted((x, sorted(y.split("*"))) for x, y in own) for name, own in parts.items()}


@pytest.mark.parametrize("form", ["full", "reduced"])
def test_the_papers_listing_term_by_term(form: Form, puma: tb.Tree) -> None:
    """[FRS96] 3.3 and 6.1: Q1, Q2, Q3, with products of sines and cosines as printed."""
    golden = SECTIONS[f"{form}_table1"]
    ours = write_equations(equations(puma, ["joint-forces"], form, zeros=True), "paper")
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
        assert len(compare_equations(puma, text, "reduced", zeros=True)["Q1"].terms) == lacking


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
@given(tree=trees((1, 4)))
@few(3)
def test_its_own_listings_read_back_as_equal(form: Form, tree: tb.Tree) -> None:
    """To the last digit, oblique axes included: what is printed is what is computed."""
    text = write_equations(equations(tree, COMPARABLE, form), "paper")
    parts = text.split("\n* ")[1:] if form == "recursive" else [text]
    for part in parts:  # auxiliary variables are each kind's own
        body = part.partition("\n")[2]
        if re.search(r"^\w+ =", body, re.MULTILINE):
            assert not any(compare_equations(tree, body, form).values())


def test_what_a_listing_or_a_request_may_not_say_is_named(puma: tb.Tree) -> None:
    """An equation that is another's would be compared with nothing, and called right."""
    own = write_equations(equations(puma, form="reduced", zeros=True), "paper")
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
                assert write_equations(found, "python") == write_equations(whole, "python")
    many = random_robot(np.random.default_rng(1), 20).tree()
    assert equations(many, "joint-forces", "recursive").equations
    with refuses(ExpressionError, "--max-terms", "recursive", " 10000 "):
        equations(many, "joint-forces", "reduced", max_terms=10_000)
