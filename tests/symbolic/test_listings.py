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
from testbed.symbolic.equations import FORMS, Form, Listing, equations
from testbed.symbolic.expression import Expression, expression
from testbed.symbolic.kinds import KINDS
from testbed.symbolic.languages import write_equations
from testbed.symbolic.parse import read_listing, wave
from testbed.symbolic.polynomial import same
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.strategies import few, trees

SECTIONS = dict(
    re.findall(r"\[(\w+)\]\n(.*?)(?=\n\[|\Z)", (GOLDEN / "equations.txt").read_text(), re.DOTALL)
)
COMPARABLE = ["joint-forces", "base-wrench", "mass-matrix", "gravity-forces"]


def printed(section: str) -> str:
    """A golden listing's text."""
    return re.sub(r"^#.*\n", "", SECTIONS[section], flags=re.MULTILINE)


def symbols(listing: Listing) -> dict[str, Expression]:
    """By name, everything that a listing's equations and definitions are written with."""
    values = [value for each in listing.equations for _, value in each.program.lines]
    values += [value for _, value in listing.definitions]
    found = {}
    todo = [factor for value in values for factors, _ in value.terms for factor in factors]
    while todo:
        factor = todo.pop()
        if factor.content is not None:
            todo += [f for factors, _ in factor.content.terms for f in factors]
        else:
            found[factor.name.replace("mbar", "mm")] = Expression((((factor,), 1),))
    return found


@pytest.mark.parametrize("form", ["full", "reduced"])
def test_the_papers_listing_term_by_term(form: Form, puma: tb.Tree) -> None:
    """[FRS96] 3.3 and 6.1: Q1, Q2, Q3 with their products of sines and cosines."""
    listing = equations(puma, ["joint-forces"], form, zeros=True)
    names = symbols(listing)
    golden = read_listing(
        printed(f"{form}_table1"), {n: v for n, v in names.items() if n[0] != "Q"}
    )
    ours = {name.name: value for name, value in listing.equations[0].program.steps}
    assert list(ours) == ["Q3", "Q2", "Q1"]
    assert (ours["Q3"], ours["Q1"]) == (golden["Q3"], golden["Q1"])
    assert ours["Q2"] - names["Q3"] == golden["Q2"] - golden["Q3"]
    assert len(golden["Q1"].terms) == {"full": 23, "reduced": 16}[form]
    found = compare_equations(puma, printed(f"{form}_table1"), form, zeros=True)
    assert set(found) == {"Q1", "Q2", "Q3"}
    assert not any(found.values())


def test_the_reaction_and_the_definitions_are_the_golden_ones(puma: tb.Tree) -> None:
    """The reaction in body 1's axes there, in the bedplate's here."""
    listing = equations(puma, ["base-wrench"], "reduced", zeros=True)
    names = symbols(listing)
    golden = read_listing(printed("reaction_table1"), names)
    ours = {name.name: value for name, value in listing.equations[0].program.steps}
    c, s = wave("C1", names), wave("S1", names)
    for here, there in (("F", "F1"), ("M", "L1")):
        x, y, z = (golden[f"{there}{axis}"] for axis in "xyz")
        assert same(ours[f"{here}x"], expression(c * x) - expression(s * y))
        assert same(ours[f"{here}y"], expression(s * x) + expression(c * y))
        assert same(ours[f"{here}z"], z)
    full = equations(puma, ["joint-forces"], "full", zeros=True)
    wanted = read_listing(printed("barycentric_table1"), symbols(full))
    found = {name.replace("mbar", "mm"): value for name, value in full.definitions}
    assert found.keys() == wanted.keys()
    assert all(same(value, wanted[name]) for name, value in found.items())


def test_the_printed_reduced_equation_lacks_a_factor_of_two(puma: tb.Tree) -> None:
    """With the sign that Table 6 gives K_d, only the three velocity terms differ."""
    listings = ROOT / "docs/listings"
    as_printed, turned = (
        compare_equations(
            puma, (listings / f"paper_reduced{end}.txt").read_text(), "reduced", zeros=True
        )["Q1"]
        for end in ("", "_sign")
    )
    assert len(as_printed.terms) == 5
    halves = "D = - Ks2d*qp1*qp2*S22 - K3d*qp1*qp2*S2233 - K3d*qp1*qp3*S2233"
    names = symbols(equations(puma, ["joint-forces"], "reduced", zeros=True))
    assert turned == read_listing(halves, names)["D"]


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


def test_results_are_called_by_their_row(puma: tb.Tree) -> None:
    """Q1 to Q3 of three joints, F and M of the plate, as their places in the array say."""
    for kind, known in KINDS.items():
        (found,) = equations(puma, kind, zeros=True).equations
        rows = [*"123"] if known.model == "dynamic" else [a + b for a in "FM" for b in "xyz"]
        assert {at[0] for at in found.places.values()} == set(range(len(rows)))
        for name, at in found.places.items():
            assert re.match(rf"(phi_)?[QGM]?{rows[at[0]]}", name.name), (name, at)


def test_what_a_listing_or_a_request_may_not_say_is_named(puma: tb.Tree) -> None:
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
    with refuses(UnknownName, "'fortran'"):
        write_equations(equations(puma), "fortran")  # type: ignore[arg-type]


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
        whole = write_equations(equations(tree, "joint-forces", form), "python")
        refused, enough = 1, 8000
        while enough - refused > 1:
            middle = (refused + enough) // 2
            try:
                found = equations(tree, "joint-forces", form, max_terms=middle)
            except ExpressionError:
                refused = middle
            else:
                enough = middle
                assert write_equations(found, "python") == whole
        steps = [value for each in found.equations for _, value in each.program.steps]
        assert enough >= sum(len(value.terms) for value in steps) / 2
    many = random_robot(np.random.default_rng(1), 20).tree()
    assert equations(many, "joint-forces", "recursive").equations
    with refuses(ExpressionError, "--max-terms", "recursive", " 10000 "):
        equations(many, "joint-forces", "reduced", max_terms=10_000)
