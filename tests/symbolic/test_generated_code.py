"""Generated equations compute what Pinocchio computes, in few operations, in every language.

Names from model files are the enemy: they may not become code.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.equations.equations import FORMS, KINDS, Equations, Form, Listing, equations
from testbed.equations.languages import Language, write_equations
from testbed.equations.robot import near_right_angles, with_right_angles
from tests.helpers.generated import c_call, c_library, latex_blocks, latex_reader, python_module
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot, random_robot, random_states
from tests.helpers.strategies import few, robots, seeds

pytestmark = pytest.mark.slow

COUNTS: dict[str, dict[str, list[int]]] = json.loads((GOLDEN / "operations.json").read_text())
"""By robot and kind: multiplications, additions, sines and cosines, and those done once."""
HOSTILE = (
    "# -*- coding: rot13 -*-", "vim: set fileencoding=utf-16 modeline:", '"""\nimport os\n"""',
    "'''; raise SystemExit", "\nimport os #", "\r\x0b\x0c\x1c\x85\u2028\u2029x = 1",
    r"\N{QUOTATION MARK}\u0027\x27\101", "*/ #error here /*", "??/\n#include <nothing.h>",
    "ends in a backslash \\", r"\end{document}\input{/etc/passwd}^^M^^5c", "%&latex $x_1$ ~#{}",
    "* Q1 = 0\nQ1 = 0", "\u0663\u202e\ufeff\x00\x1a\x1b[31m\udc80", "-" * 3000, "",
)  # fmt: skip


def named(path: str) -> tb.Tree:
    """A robot of the golden ones."""
    return tb.load_tree(GOLDEN / f"robots/{path}.urdf")


def vector(each: Equations, listing: Listing) -> Array:
    """The parameters that the equations are in."""
    theta = tb.barycentric(listing.tree)
    return (
        theta.ravel() if listing.form == "full" else listing.minimal[each.kind.model].values(theta)
    )


def computed(listing: Listing, states: tuple[Array, ...], source: str = "") -> dict[str, Array]:
    """Results of Python, C and LaTeX by kind, which are the same; regressors times parameters."""
    with TemporaryDirectory() as name:
        module = python_module(write_equations(listing, "python", source), Path(name))
        strict = ("-O0", "-trigraphs", "-finput-charset=utf-8")
        library = c_library(write_equations(listing, "c", source), Path(name), *strict)
    printed = by_latex(listing, states, source)
    results = {}
    for each, in_latex in zip(listing.equations, printed, strict=True):
        name, inputs = each.kind.name.replace("-", "_"), states[: len(each.kind.takes)]
        given = [] if each.kind.is_regressor else [vector(each, listing)]
        found = getattr(module, name)(*inputs, *given)
        samples = zip(*inputs, strict=True)
        in_c = [c_call(library, name, [*sample, *given], each.shape) for sample in samples]
        for other in (in_c, in_latex):
            np.testing.assert_allclose(other, found, rtol=0, atol=1e-12 * max(1, abs(found).max()))
        results[each.kind.name] = found if given else found @ vector(each, listing)
    return results


def by_latex(listing: Listing, states: tuple[Array, ...], source: str) -> Iterator[list[Array]]:
    """Every number, name and power of the document is read, and nothing else is used."""
    blocks = latex_blocks(write_equations(listing, "latex", source))
    constants: dict[str, float] = {}
    if listing.constants:
        constants = {left: latex_reader(())(right, {}, ()) for left, right in blocks.pop(0)}
    for each, block in zip(listing.equations, blocks, strict=True):
        written = [label for label, value in each.program.lines if value or len(each.shape) == 1]
        assert block == [("0", "0")] if not written else len(block) == len(written)
        known = dict(constants)
        if not each.kind.is_regressor:
            for value, parameter in zip(vector(each, listing), each.parameters, strict=True):
                known[parameter.label.without_multiple.latex] = value / parameter.multiple
        found = []
        for sample in zip(*states, strict=True):
            names, result = dict(known), np.zeros(each.shape)
            for letter, values in zip(("q", r"\dot q", r"\ddot q"), sample, strict=True):
                names |= {f"{letter}_{{{k + 1}}}": float(v) for k, v in enumerate(values)}
            value_of = latex_reader([*names, *(left for left, _ in block)])
            for label, (left, right) in zip(written, block, strict=False):
                assert left not in names, f"{left} stands for two things"
                names[left] = value_of(right, names, sample[0])
                if label in each.result_indices:
                    result[each.result_indices[label]] = names[left]
            found.append(result)
        yield found


def check(listing: Listing, urdf: str, seed: int = 0) -> None:
    """All languages against Pinocchio."""
    states = random_states(np.random.default_rng(seed), 2, listing.tree.n)
    witness = by_pinocchio(urdf, listing.tree, states)
    wanted = {
        "joint-forces": witness.forces, "torque-regressor": witness.forces,
        "base-wrench": witness.wrench, "wrench-regressor": witness.wrench,
        "mass-matrix": witness.mass, "gravity-forces": witness.gravity,
    }  # fmt: skip
    for kind, found in computed(listing, states).items():
        scale = max(1.0, np.abs(wanted[kind]).max())
        np.testing.assert_allclose(found, wanted[kind], rtol=0, atol=1e-12 * scale, err_msg=kind)


@pytest.mark.parametrize("form", FORMS)
@given(robot=robots((1, 4)), seed=seeds)
@few(3)
def test_equations_of_any_tree_compute_what_pinocchio_does(
    form: Form, robot: Robot, seed: int
) -> None:
    """A wrong term would send torques to a robot: all kinds, Python, C and the printed page."""
    check(equations(robot.tree(), list(KINDS), form), robot.urdf(), seed)


@pytest.mark.parametrize("name", ["puma560_6", "random_tree_08"])
def test_equations_of_real_arms_compute_what_pinocchio_does(name: str) -> None:
    """Some with more than nine joints, where s_{12} is the sine of q12, not of q1 + q2."""
    kinds = ["joint-forces", "mass-matrix", "base-wrench"]
    urdf = (GOLDEN / f"robots/{name}.urdf").read_text()
    listing = equations(named(name), kinds, "recursive")
    check(listing, urdf)
    kept = {str(step) for each in listing.equations for step, _ in each.program.steps}
    for letter in ("w", "wd", "a", "F", "L"):  # each by the number of its body
        bodies = {int(k) for each in kept for k in re.findall(rf"^{letter}(\d+)[xyz]", each)}
        assert 0 < min(bodies) <= max(bodies) == listing.tree.n, letter


@pytest.mark.parametrize("form", ["full", "recursive"])
def test_known_zeros_are_left_out_and_the_rest_agrees(form: Form, puma: tb.Tree) -> None:
    """Equations of a symmetric arm are half as long; what is left is still the arm."""
    listing = equations(puma, list(KINDS), form, zeros=True)
    check(listing, (ROOT / "models/puma562.urdf").read_text())
    assert not re.search(r"\b(mbs?\dx|Ks?\dx[yz])", write_equations(listing, "paper"))
    assert equations(puma, "mass-matrix", form, zeros="mb3x").known_zero.sum() == 1


def test_hostile_names_change_no_result_and_stand_in_comments_only() -> None:
    """A downloaded robot must not run code on the machine that generates equations."""
    plain = random_robot(np.random.default_rng(2), len(HOSTILE)).tree()
    pairs = zip(plain.joints, HOSTILE, strict=True)
    joints = tuple(replace(j, name=f"{name}{j.name}", body=name) for j, name in pairs)
    states = random_states(np.random.default_rng(3), 1, plain.n)
    one = equations(plain, ["gravity-forces"], "recursive")
    other = equations(replace(plain, joints=joints), ["gravity-forces"], "recursive")
    marks: dict[Language, str] = {"paper": "*", "latex": "%", "python": "#", "c": " *"}
    for language, mark in marks.items():
        text = write_equations(one, language, one.tree.name)
        code = [each for each in text.splitlines() if not each.startswith(mark)]
        for name in HOSTILE:
            odd = replace(other, tree=replace(other.tree, name=name))
            lines = write_equations(odd, language, name).splitlines()
            assert [each for each in lines if not each.startswith(mark)] == code
            assert all(each.isascii() for each in lines)
            assert max(len(each) for each in lines if each.startswith(mark)) < 300
    (found,) = computed(other, states, HOSTILE[0]).values()
    (wanted_forces,) = computed(one, states).values()
    np.testing.assert_array_equal(found, wanted_forces)
    own = write_equations(other, "paper", HOSTILE[-4])
    assert not any(tb.compare_equations(plain, own, "recursive").values())


@pytest.mark.parametrize("name", COUNTS)
def test_operations_are_as_few_as_they_were(name: str) -> None:
    """Exactly: real-time code that gets slower shows, and what gets faster is written down."""
    for each in equations(named(name), list(COUNTS[name]), "recursive").equations:
        c = each.program.count
        found = [c.multiplications, c.additions, c.trigonometric, c.once]
        assert found == COUNTS[name][each.kind.name]
    (forces, *_) = COUNTS["puma560_6"].values()
    assert (forces[0], forces[1]) < (319, 266)  # OpenSYMORO's
    assert sum(COUNTS["humanoid_pelvis"]["joint-forces"][:2]) < 140 * 38  # ROBOTRAN's a joint


def test_the_same_bits_in_every_process() -> None:
    """Nothing depends on the order of hashes: generated code can be kept under version control."""
    what = [str(GOLDEN / "robots/gantry_ppp_rrr.urdf"), "--what", "torque-regressor"]
    how = ["--form", "reduced", "--language", "python"]
    command = [sys.executable, "-m", "testbed", "equations", *what, *how]
    seeded = [os.environ | {"PYTHONHASHSEED": seed} for seed in ("1", "2")]
    texts = [subprocess.check_output(command, env=each, cwd=ROOT) for each in seeded]
    assert texts[0] == texts[1]


def test_generated_python_takes_samples_of_any_shape_and_refuses_others(
    puma: tb.Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = write_equations(equations(puma, ["joint-forces"], "recursive"), "python")
    module = python_module(text, tmp_path)
    delta, states = np.linspace(0.1, 1.5, 15), random_states(np.random.default_rng(1), 10_000, 3)
    whole = module.joint_forces(*states, delta)
    cube = [x.reshape(10, 1000, 3) for x in states]
    np.testing.assert_array_equal(module.joint_forces(*cube, delta).reshape(-1, 3), whole)
    assert module.joint_forces(*(x[5] for x in states), delta).shape == (3,)
    monkeypatch.setattr(module, "BLOCK", 7)
    np.testing.assert_allclose(module.joint_forces(*states, delta), whole, rtol=1e-14, atol=1e-13)
    with refuses(ValueError):
        module.joint_forces(states[0][:, :2], *states[1:], delta)
    with refuses(ValueError, "15", "9"):
        module.joint_forces(*states, delta[:9])


@given(st.sampled_from([0.0, 1e-9, -0.9e-4, 1.1e-4, -2e-4]))
def test_turns_close_to_quarter_turns_are_said_and_squared_and_others_stay(off: float) -> None:
    """Angles rounded in a file would make ten times as long equations."""
    axis = np.array([0, np.sin(off), np.cos(off)])
    joint = tb.Joint("a", "b", "revolute", -1, axis, np.zeros(3), np.eye(3))
    tree = tb.Tree("one", (joint,), (tb.Inertia(1.0, np.ones(3), np.eye(3)),))
    close = abs(off) < 1e-4
    np.testing.assert_array_equal(
        with_right_angles(tree).joints[0].axis, [0, 0, 1] if close else axis
    )
    assert set(near_right_angles(tree)) == ({"a"} if 1e-12 < abs(off) < 1e-4 else set())
