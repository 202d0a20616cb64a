"""Formulas and names: what is printed is what the matrix does, in text and in LaTeX."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.parameters.barycentric import component_symbol, parameter_names, parameter_symbols
from testbed.parameters.formulas import length_symbol
from testbed.parameters.rules import Model
from testbed.parameters.symbols import Symbol
from tests.helpers.robots import random_robot
from tests.helpers.strategies import few, rngs, trees

models: st.SearchStrategy[Model] = st.sampled_from(["dynamic", "reaction"])


@few(40)
@given(st.one_of(trees((1, 7)), trees((1, 7), bare=True)), rngs, models, st.booleans())
def test_formulas_say_what_the_matrix_does(
    tree: tb.Tree, rng: np.random.Generator, model: Model, zeros: bool
) -> None:
    """Each, evaluated on random parameters, gives S theta; what is known to be zero is not named.

    Auxiliary ones come before what refers to them, once each, and only where they are needed.
    """
    minimal = tb.minimal_set(tree, model, zeros=zeros)
    theta = np.where(minimal.known_zero, 0.0, rng.normal(size=(tree.n, 10)))
    given_ = zip(parameter_names(tree), theta.ravel().tolist(), strict=True)
    known = {name: value for name, value in given_ if value}
    for j, joint in enumerate(tree.joints):
        for x, length in zip("xyz", joint.offset, strict=True):
            known[length_symbol(joint.parent, j, x).text] = float(length)
    for formula in minimal.auxiliary:
        assert formula.left.text not in known
        known[formula.left.text] = evaluate(formula.said, known)
    for formula, value in zip(minimal.formulas, minimal.values(theta), strict=True):
        assert evaluate(formula.said, known) == pytest.approx(value, abs=1e-4), formula  # 6 digits
    both = (*minimal.formulas, *minimal.auxiliary)
    named = {term.symbol for formula in both for term in formula.right}
    told = {label.symbols[0] for label in minimal.labels if label.times == 1}
    starred = {s for s in named if isinstance(s, Symbol) and s.star}
    assert starred - told == {formula.left.symbols[0] for formula in minimal.auxiliary}
    assert minimal.names == tuple(label.text for label in minimal.labels)


def evaluate(text: str, known: dict[str, float]) -> float:
    """The value of a sum of products; a star inside a name belongs to the name."""
    names = sorted(known, key=len, reverse=True)
    pattern = re.compile("|".join(re.escape(n) for n in names if not n.startswith("2*")) or "$^")
    numbers = pattern.sub(lambda match: f"({known[match.group()]!r})", text)
    assert re.fullmatch(r"[-+*/(). 0-9e]*", numbers), (text, numbers)
    return float(eval(numbers))  # digits and operators only


def test_formulas_of_the_puma_are_the_papers(puma: tb.Tree) -> None:
    minimal = tb.minimal_set(puma, "reaction", zeros=True)
    said = {str(formula) for formula in (*minimal.formulas, *minimal.auxiliary)}
    assert {
        *("K*1yz = K1yz - l12z*mb*2y", "mb*1y = mb1y + mb*2y", "mb*2y = mb2y + mb3y"),
        *("K*2yz = K2yz - l23z*mb3y", "2*K3d = K3xx - K3zz", "K*1zz = K1zz + K*2xx/2 + K*2zz/2"),
        "K*2xx = K2xx + K3xx/2 + K3zz/2",
    } <= said
    numbers = map(str, tb.minimal_set(puma, "dynamic", zeros=True).formulas_with("numbers"))
    assert "K*2yz = K2yz - 0.4318*mb3y" in numbers
    latex = {f.left.text: f.latex() for f in minimal.formulas}
    assert latex["K*1yz"] == r"K^{*1}_{yz} = K^{1}_{yz} - l^{12}_{z}\,m\!b^{*2}_{y}"
    assert latex["K*1zz"].endswith(r" + \tfrac{1}{2}\,K^{*2}_{xx} + \tfrac{1}{2}\,K^{*2}_{zz}")
    assert latex["mbar1"] == r"\bar{m}^{1} = \bar{m}^{1}"
    assert latex["2*K3d"] == r"2\,K^{3}_{d} = K^{3}_{xx} - K^{3}_{zz}"


def test_every_name_is_one_parameters_beyond_the_ninth_body_too() -> None:
    tree = random_robot(np.random.default_rng(0), 12).tree()
    names = parameter_names(tree)
    assert len(set(names)) == len({symbol.latex for symbol in parameter_symbols(tree)}) == 120
    assert [length_symbol(*at).text for at in ((8, 9, "y"), (-1, 0, "x"))] == ["l9_10y", "l01x"]
    assert length_symbol(8, 9, "y").latex == "l^{9,10}_{y}"
    assert component_symbol(11, 0, star=True).text == "mbar12"  # a mass is never redefined
