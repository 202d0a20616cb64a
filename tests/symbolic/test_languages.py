"""What is written reads back: Python runs, C compiles, LaTeX and the paper's notation are read.

Names from model files are the enemy: they may not become code in any language.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.arrays import Array
from testbed.symbolic.budget import Budget
from testbed.symbolic.compare import compare_equations
from testbed.symbolic.equations import FORMS, Equations, Form, Listing, equations, writer
from testbed.symbolic.expression import Nature, number, symbol
from testbed.symbolic.kinds import KINDS
from testbed.symbolic.languages import Language, write_equations
from testbed.symbolic.languages.paper import line
from testbed.symbolic.languages.text import harmless
from testbed.symbolic.parse import read_listing
from testbed.symbolic.robot import draw
from tests.helpers.generated import LatexReader, c_call, c_library, latex_blocks, python_module
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.robots import random_robot, random_states

pytestmark = pytest.mark.slow

HOSTILE = (
    "coding: utf-7",
    "# -*- coding: rot13 -*-",
    "coding=utf-16",
    "vim: set fileencoding=utf-16 modeline:",
    '"""\nimport os\n"""',
    "'''; raise SystemExit",
    "\nimport os #",
    "\r\x0b\x0c\x1c\x85\u2028\u2029x = 1",
    r"\N{QUOTATION MARK}\u0027\x27\101",
    "*/ #error here /*",
    "/* // */",
    "??/",
    "??/\n#include <nothing.h>",
    "ends in a backslash \\",
    "\\\n\\",
    r"\end{document}\input{/etc/passwd}^^M^^5c",
    "%&latex $x_1$ ~#{}",
    "* Q1 = 0\nQ1 = 0",
    "é日本\u0663\u202e\u2066\ufeff\x00\x1a\x1b[31m\udc80",
    "-" * 3000,
    "",
)


def named(name: str) -> tb.Tree:
    """The PUMA with this name for everything."""
    tree = tb.load_tree(ROOT / "models/puma562.urdf")
    joints = tuple(replace(j, name=f"{name}{k}", body=name) for k, j in enumerate(tree.joints))
    return replace(tree, name=name, joints=joints)


def parameters(each: Equations, listing: Listing) -> Array:
    theta = tb.barycentric(listing.tree)
    minimal = listing.minimal.get(each.kind.model)
    return theta.ravel() if minimal is None else minimal.values(theta)


def by_python(
    listing: Listing, folder: Path, states: tuple[Array, ...], source: str = ""
) -> dict[str, Array]:
    """Results by kind, for each sample."""
    module = python_module(write_equations(listing, "python", source), folder)
    found = {}
    for each in listing.equations:
        given = [] if each.kind.is_regressor else [parameters(each, listing)]
        function = getattr(module, each.kind.name.replace("-", "_"))
        found[each.kind.name] = function(*states[: len(each.kind.takes)], *given)
    return found


def by_c(
    listing: Listing, folder: Path, states: tuple[Array, ...], source: str = ""
) -> dict[str, Array]:
    library = c_library(
        write_equations(listing, "c", source), folder, "-O0", "-trigraphs", "-finput-charset=utf-8"
    )
    found = {}
    for each in listing.equations:
        given = [] if each.kind.is_regressor else [parameters(each, listing)]
        name = each.kind.name.replace("-", "_")
        samples = zip(*states[: len(each.kind.takes)], strict=True)
        values = [c_call(library, name, [*sample, *given], each.shape) for sample in samples]
        found[each.kind.name] = np.array(values)
    return found


def by_latex(listing: Listing, states: tuple[Array, ...], source: str = "") -> dict[str, Array]:
    """Every number, name and power of the document is read, and nothing else is used."""
    blocks = latex_blocks(write_equations(listing, "latex", source))
    nothing = np.zeros(0)
    constants: dict[str, float] = {}
    if listing.constants:
        constants = {left: LatexReader(right, {}, nothing).value() for left, right in blocks.pop(0)}
    found = {}
    assert len(blocks) == len(listing.equations)
    for each, block in zip(listing.equations, blocks, strict=True):
        values = []
        for sample in zip(*states, strict=True):
            values.append(read_block(each, block, constants, sample, parameters(each, listing)))
        found[each.kind.name] = np.array(values)
    return found


def read_block(
    each: Equations,
    block: list[tuple[str, str]],
    constants: dict[str, float],
    sample: tuple[Array, ...],
    vector: Array,
) -> Array:
    letters = ("q", r"\dot q", r"\ddot q")
    names = dict(constants)
    for letter, values in zip(letters, sample, strict=True):
        names |= {f"{letter}_{{{k + 1}}}": float(v) for k, v in enumerate(values)}
    if not each.kind.is_regressor:
        for value, parameter in zip(vector, each.parameters, strict=True):
            names[parameter.label.stem.latex] = value / parameter.times
    result = np.zeros(each.shape)
    written = [label for label, value in each.program.lines if value or len(each.shape) == 1]
    assert block == [("0", "0")] if not written else len(block) == len(written)
    for label, (left, right) in zip(written, block, strict=False):
        assert left not in names, f"{left} stands for two things"
        names[left] = LatexReader(right, names, sample[0]).value()
        if label in each.places:
            result[each.places[label]] = names[left]
    return result


def states_of(tree: tb.Tree, samples: int = 2) -> tuple[Array, ...]:
    q, qd, qdd = random_states(np.random.default_rng(3), samples, tree.n)
    return q, qd, qdd


def close(found: dict[str, Array], expected: dict[str, Array]) -> None:
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        assert found[name].shape == values.shape
        assert np.abs(found[name] - values).max() <= 1e-12 * max(1.0, np.abs(values).max()), name


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    "name", ["puma562_paper", "gantry_ppp_rrr", "t2_rp_inclined_v", "pendulum"]
)
def test_latex_reads_back(name: str, form: Form, tmp_path: Path) -> None:
    tree = tb.load_tree(GOLDEN / f"robots/{name}.urdf")
    listing = equations(tree, list(KINDS), form)
    states = states_of(tree)
    close(by_latex(listing, states), by_python(listing, tmp_path, states))


@pytest.mark.parametrize("numbers", [False, True])
def test_latex_of_twelve_joints_reads_back(numbers: bool, tmp_path: Path) -> None:
    """From ten joints on, s_{12} is the sine of q12, not of q1 + q2."""
    robot = random_robot(np.random.default_rng(5), 12, gravity=(1, -2, -9))
    listing = equations(robot.tree(), ["joint-forces", "mass-matrix"], "recursive", numbers=numbers)
    states = states_of(listing.tree)
    close(by_latex(listing, states), by_python(listing, tmp_path, states))


@pytest.mark.parametrize("name", HOSTILE, ids=range(len(HOSTILE)))
def test_hostile_names_change_no_result_in_any_language(name: str, tmp_path: Path) -> None:
    kinds = ["joint-forces", "mass-matrix"]
    plain, hostile = (equations(named(each), kinds, "recursive") for each in ("arm", name))
    states = states_of(plain.tree)
    (tmp_path / "plain").mkdir()
    (tmp_path / "hostile").mkdir()
    expected = by_python(plain, tmp_path / "plain", states)
    found = by_python(hostile, tmp_path / "hostile", states, source=name)
    for kind, values in expected.items():
        np.testing.assert_array_equal(found[kind], values)
    close(by_c(hostile, tmp_path / "hostile", states, source=name), expected)
    close(by_latex(hostile, states, source=name), expected)
    text = write_equations(equations(named(name), form="full"), "paper", name)
    assert not any(compare_equations(plain.tree, text, "full").values())


@pytest.mark.parametrize("language", ["paper", "latex", "python", "c"])
@pytest.mark.parametrize("name", HOSTILE, ids=range(len(HOSTILE)))
def test_names_stand_in_comments_and_all_else_is_as_without_them(
    name: str, language: Language
) -> None:
    plain, hostile = (
        write_equations(
            equations(named(each), form="recursive"), language, f"of {each}"
        ).splitlines()
        for each in ("arm", name)
    )
    mark = {"paper": "*", "latex": "%", "python": "#", "c": " *"}[language]
    assert len(plain) == len(hostile)
    changed = [(a, b) for a, b in zip(plain, hostile, strict=True) if a != b]
    assert all(a.startswith(mark) and b.startswith(mark) for a, b in changed)
    if language == "python":
        assert hostile[:2] == plain[:2] == ["# -*- coding: utf-8 -*-", "# Written by testbed."]


@given(st.text())
def test_what_is_harmless_is_ascii_without_signs_that_any_language_obeys(text: str) -> None:
    shown = harmless(text)
    assert shown.isascii()
    assert len(shown) <= 120
    assert not set(shown) - set("_.,+-() /") - {c for c in shown if c.isalnum()}
    assert harmless(shown) == shown


@given(st.integers(-200, 200), st.integers(0, 10))
def test_numbers_are_written_as_people_do_and_read_back(over: int, shift: int) -> None:
    """1/2 and 3/4, not 0.5 and 0.75; what is no small fraction to its last digit."""
    g = symbol(Nature.CONSTANT, "g")
    value = Fraction(over, 2**shift)
    term = g * (over / 2**shift)
    text = line(term if over else number(0))
    if value and value.denominator in (2, 4, 8, 16, 32, 64):
        assert text.lstrip("-") == f"{abs(value)}*g"
    read = read_listing(f"Q1 = {text}", {"g": g})["Q1"]
    assert read == (term if over else number(0))


def test_halves_stand_in_listings() -> None:
    """A product of sine and cosine leaves a half where no parameter takes it up."""
    tree = tb.load_tree(GOLDEN / "robots/spherical_wrist.urdf")
    robot = draw(tree, tree.gravity)
    text = write_equations(equations(tree, ["joint-forces"], "full"), "paper")
    assert "1/2*" in text
    assert "0.5" not in text
    assert line(writer(robot, Budget())(robot.q[0] * 0.5)) == "1/2*q1"
