"""How many operations generated equations take: counted, few, and never more than before."""

from __future__ import annotations

import ast
import json
import re

import numpy as np
import pytest

import testbed as tb
from testbed.symbolic.angles import almost_right, right_angles
from testbed.symbolic.equations import FORMS, Form, equations
from testbed.symbolic.languages import write_equations
from tests.helpers.cases import cases
from tests.helpers.paths import GOLDEN

COUNTS: dict[str, dict[str, list[int]]] = json.loads((GOLDEN / "operations.json").read_text())
"""By robot and kind: multiplications, additions, sines and cosines, and those done once."""


def counted(text: str, name: str) -> tuple[int, int]:
    """Multiplications and additions of a generated Python function, by its syntax tree."""
    tree = ast.parse(text)
    (function,) = [f for f in tree.body if isinstance(f, ast.FunctionDef) and f.name == f"_{name}"]
    products = sums = 0
    for line in function.body:
        targets = [t for t in getattr(line, "targets", []) if isinstance(t, ast.Name)]
        if any(re.fullmatch(r"k\d+|[SC]_?[\dm_]+", t.id) for t in targets):
            continue  # once for all samples; angles of sines
        if isinstance(line, ast.Assign | ast.AugAssign):
            sums += isinstance(line, ast.AugAssign)
            for node in ast.walk(line.value):
                if isinstance(node, ast.BinOp):
                    products += isinstance(node.op, ast.Mult)
                    sums += isinstance(node.op, ast.Add | ast.Sub)
    return products, sums


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", cases(["random_tree_00", "gantry_ppp_rrr", "puma560_6"], fast=1))
def test_operations_are_those_of_the_code(name: str, form: Form) -> None:
    tree = tb.load_tree(GOLDEN / f"robots/{name}.urdf")
    listing = equations(tree, ["joint-forces", "dynamic-regressor"], form)
    text = write_equations(listing, "python")
    for each in listing.equations:
        count = each.program.count
        found = counted(text, each.kind.name.replace("-", "_"))
        assert found == (count.multiplications, count.additions)


def test_fewer_operations_than_other_generators() -> None:
    """OpenSYMORO's counts for the PUMA 560; ROBOTRAN's for a joint of a large tree."""
    tree = tb.load_tree(GOLDEN / "robots/puma560_6.urdf")
    forces, regressor = equations(
        tree, ["joint-forces", "dynamic-regressor"], "recursive"
    ).equations
    assert forces.program.count.multiplications < 319
    assert forces.program.count.additions < 266
    assert regressor.program.count.multiplications < 1323
    assert regressor.program.count.additions < 749
    large = tb.load_tree(GOLDEN / "robots/humanoid_pelvis.urdf")
    count = equations(large, ["joint-forces"], "recursive").equations[0].program.count
    assert count.multiplications + count.additions < 140 * large.n


@pytest.mark.parametrize("name", COUNTS)
def test_operations_are_as_few_as_they_were(name: str) -> None:
    """Exactly: a program that does less well shows, and one that does better is written down."""
    tree = tb.load_tree(GOLDEN / f"robots/{name}.urdf")
    listing = equations(tree, list(COUNTS[name]), "recursive")
    found = {each.kind.name: each.program.count for each in listing.equations}
    assert {
        kind: [c.multiplications, c.additions, c.trigonometric, c.once] for kind, c in found.items()
    } == COUNTS[name]


@pytest.mark.parametrize(("off", "meant"), [(0.0, True), (0.9e-4, True), (1.1e-4, False)])
def test_turns_close_to_quarter_turns_are_meant_to_be_some(off: float, meant: bool) -> None:
    """And are said; others stay as they are."""
    axis = np.array([0, np.sin(off), np.cos(off)])
    joint = tb.Joint("a", "b", "revolute", -1, axis, np.zeros(3), np.eye(3))
    tree = tb.Tree("one", (joint,), (tb.Inertia(1.0, np.ones(3), np.eye(3)),))
    squared = right_angles(tree).joints[0].axis
    if meant:
        np.testing.assert_array_equal(squared, [0, 0, 1])
        assert set(almost_right(tree)) == ({"a"} if off else set())
    else:
        np.testing.assert_array_equal(squared, joint.axis)
        assert almost_right(tree) == {}
