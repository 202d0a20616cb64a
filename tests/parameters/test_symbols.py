"""Names and formulas as values: how they are written, and what they refer to."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.parameters.barycentric import component_symbol, parameter_names, parameter_symbols
from testbed.parameters.formulas import length_symbol
from testbed.parameters.rules import Model
from testbed.parameters.symbols import DriveSymbol, Formula, Label, Symbol, Term, join
from tests.helpers.robots import random_robot

MODELS: tuple[Model, ...] = ("dynamic", "reaction")
A, B = Symbol("K", (2,), "xz"), Symbol("mb", (2,), "x", star=True)
L = Symbol("l", (1, 2), "z")


def weighed(value: float, *lengths: Symbol) -> Term:
    return Term(B, tuple((value, length) for length in lengths) or ((value, None),))


@pytest.mark.parametrize(
    ("term", "text", "latex"),
    [
        (Term(A), "K2xz", "K^{2}_{xz}"),
        (weighed(-1.0), "-mb*2x", r"-m\!b^{*2}_{x}"),
        (weighed(0.5), "mb*2x/2", r"\tfrac{1}{2}\,m\!b^{*2}_{x}"),
        (weighed(-1.5), "-3/2*mb*2x", r"-\tfrac{3}{2}\,m\!b^{*2}_{x}"),
        (weighed(2.0, L), "2*l12z*mb*2x", r"2\,l^{12}_{z}\,m\!b^{*2}_{x}"),
        (weighed(0.0123), "0.0123*mb*2x", r"0.0123\,m\!b^{*2}_{x}"),
        (weighed(1.25e-5), "1.25e-05*mb*2x", r"1.25\cdot 10^{-5}\,m\!b^{*2}_{x}"),
        (
            Term(B, ((1.0, None), (-2.0, L))),
            "(1 - 2*l12z)*mb*2x",
            r"(1 - 2\,l^{12}_{z})\,m\!b^{*2}_{x}",
        ),
        (
            Term(DriveSymbol("rotor", "arm_1")),
            "rotor/arm_1",
            r"\mathrm{rotor}_{\mathrm{arm\_1}}",
        ),
    ],
)
def test_a_term_is_written(term: Term, text: str, latex: str) -> None:
    assert term.write("text") == text
    assert term.write("latex") == latex


def test_sums_take_the_signs_of_their_terms() -> None:
    assert join((Term(A), weighed(-2.0), weighed(1.0, L)), "text") == "K2xz - 2*mb*2x + l12z*mb*2x"
    assert join((weighed(-1.0),), "text") == "-mb*2x"
    assert join((), "text") == join((), "latex") == "0"


def test_a_label_is_one_word_and_knows_its_multiple() -> None:
    double = Label((Term(A, ((2.0, None),)),))
    assert (double.text, double.times, double.stem.text) == ("2*K2xz", 2, "K2xz")
    total = Label((Term(A), weighed(-0.3)))
    assert (total.text, total.times) == ("K2xz-0.3*mb*2x", 1)
    assert total.stem == total
    assert total.symbols == (A, B)


def test_a_formula_has_two_sides() -> None:
    formula = Formula(Label((Term(A),)), (Term(A), weighed(1.0, L)))
    assert str(formula) == "K2xz = K2xz + l12z*mb*2x"
    assert formula.said == "K2xz + l12z*mb*2x"
    assert formula.latex("&=").startswith("K^{2}_{xz} &= K^{2}_{xz} + ")
    assert not formula.trivial
    assert Formula(Label((Term(A),)), (Term(A),)).trivial
    assert str(Formula(Label((Term(A),)), ())) == "K2xz = 0"


def test_bodies_beyond_the_ninth_are_told_apart() -> None:
    assert length_symbol(8, 9, "y").text == "l9_10y"
    assert length_symbol(8, 9, "y").latex == "l^{9,10}_{y}"
    assert length_symbol(-1, 0, "x").text == "l01x"
    assert component_symbol(11, 0).latex == r"\bar{m}^{12}"
    assert component_symbol(11, 9, star=True).text == "K*12zz"
    assert component_symbol(11, 0, star=True).text == "mbar12"  # a mass is never redefined


def test_every_name_is_one_parameters() -> None:
    tree = random_robot(np.random.default_rng(0), 12).tree()
    names = parameter_names(tree)
    assert len(set(names)) == len(names) == 120
    assert names[:5] == ("mbar1", "mb1x", "mb1y", "mb1z", "K1xx")
    assert len({symbol.latex for symbol in parameter_symbols(tree)}) == 120


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(20))
def test_auxiliary_formulas_are_those_referred_to(seed: int, model: Model) -> None:
    """Each starred parameter on a right-hand side, once, and none that is in the set itself.

    Tips first, so that each refers only to those before it.
    """
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 7).tree()
    for zeros in (False, True):
        minimal = tb.minimal_set(tree, model, zeros=zeros)
        told = {label.symbols[0] for label in minimal.labels if label.times == 1}
        written = [formula.left.symbols[0] for formula in minimal.auxiliary]
        assert len(set(written)) == len(written)
        assert not set(written) & told
        both = (*minimal.formulas, *minimal.auxiliary)
        named = {term.symbol for formula in both for term in formula.right}
        starred = {s for s in named if isinstance(s, Symbol) and s.star}
        assert starred - told == set(written)
        known: set[object] = set()
        for formula in minimal.auxiliary:
            needs = {t.symbol for t in formula.right if isinstance(t.symbol, Symbol)}
            assert {s for s in needs if s.star} - told <= known
            known.add(formula.left.symbols[0])


def test_names_are_those_of_the_labels(puma: tb.Tree) -> None:
    for model in MODELS:
        minimal = tb.minimal_set(puma, model)
        assert minimal.names == tuple(label.text for label in minimal.labels)
        assert {label.times for label in minimal.labels} == {1, 2}
