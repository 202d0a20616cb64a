"""What no joint can have, and what is known better than its file knows it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.errors import ModelError, UnknownName
from testbed.robot.friction import LAWS, drive_torque, friction_torque, joint_law, joint_terms
from testbed.robot.tree import SETTABLE
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.strategies import rngs, trees, wrong_numbers


@given(st.sampled_from(SETTABLE), wrong_numbers, wrong_numbers)
def test_what_no_joint_can_have_is_refused(name: str, a: Any, b: Any) -> None:
    """Robots with friction that drives them would be identified as such."""
    tree = random_robot(np.random.default_rng(0), 3).tree()
    value = [a, b] if name == "position_range" else a
    ranges = name == "position_range" and {type(a), type(b)} == {float} and a <= b
    if not ranges and not (name.startswith("max") and a == math.inf):
        with refuses(ModelError, "'j2'"):
            tree.with_joints({"j2": {name: value}})
    for settings, *culprits in (({"j": {}}, "'j'", "'j3'"), ({"j2": {"max_speed": 1.0}}, "'j2'")):
        with refuses(UnknownName, *culprits):
            tree.with_joints(settings)


def test_gravity_is_replaced_or_the_files_or_down(puma: tb.Tree) -> None:
    """On the moon a robot weighs a sixth; a mistake in a unit would be identified as masses."""
    for asked, found in (([0, 0, -1.62], [0, 0, -1.62]), (None, puma.gravity), ((0, 0, 0), 0)):
        np.testing.assert_array_equal(puma.with_gravity(asked).gravity, found)
    np.testing.assert_array_equal(tb.Tree("b", (), ()).gravity, [0.0, 0.0, -9.81])
    wrong: list[Any] = [1e-300, 1e4 * 1.01, 10**400, math.nan, math.inf, True, None, []]
    for each in wrong:
        with refuses(ModelError, "gravity"):
            puma.with_gravity([0, 0, each])


# what joints' torques hold besides

UNITS = {
    "coulomb": ("N m", "N"), "viscous": ("N m s/rad", "N s/m"), "offset": ("N m", "N"),
    "rotor": ("kg m^2", "kg"), "asymmetric": ("N m s/rad", "N s/m"),
    "quadratic": ("N m s^2/rad^2", "N s^2/m^2"), "square_root": ("N m s^.5/rad^.5", "N s^.5/m^.5"),
}  # fmt: skip


@given(trees((2, 6)), rngs)
def test_friction_and_rotors_are_the_textbooks_with_their_units(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """Simulation and estimator read the same laws: wrong here is wrong in both, unseen."""
    values = rng.uniform(0, 5, (3, tree.n))
    keys = ("coulomb", "viscous", "rotor_inertia")
    given = {n: dict(zip(keys, values[:, k], strict=True)) for k, n in enumerate(tree.names)}
    tree = tree.with_joints(given)
    qd, qdd = rng.normal(size=(2, 50, tree.n))
    qd[0] = 0.0
    expected = values[0] * np.sign(qd) + values[1] * qd
    np.testing.assert_allclose(friction_torque(tree, qd), expected, rtol=1e-14)
    np.testing.assert_allclose(drive_torque(tree, qd, qdd), expected + values[2] * qdd, rtol=1e-13)
    smooth = values[0] * np.tanh(qd / 0.05) + values[1] * qd
    np.testing.assert_allclose(friction_torque(tree, qd, 0.05), smooth, rtol=1e-12)
    for term in joint_terms(tree, LAWS):
        joint = tree.joints[term.joint]
        assert term.unit(tree) == UNITS[term.law.kind][not joint.revolute]
        assert term.name(tree) == f"{term.law.kind}/{joint.name}"
    for law, field in (("coulomb", 0), ("viscous", 1), ("rotor", 2)):
        np.testing.assert_array_equal(joint_law(law).coefficients(tree), values[field])


def test_laws_are_found_by_name() -> None:
    """Another law than the one asked for would be fitted."""
    columns = [float(joint_law(law.kind).column(-0.25, 3.0)) for law in LAWS]
    assert columns == [-1.0, -0.25, 1.0, 3.0, 0.25, -0.0625, -0.5]
    assert joint_law("stribeck@0.08").column(-0.08, 0.0) == pytest.approx(-np.exp(-1))
    for wrong in ("viscos", *(f"stribeck@{x}" for x in ("", "0", "fast", "-1", "inf"))):
        with refuses(UnknownName, f"'{wrong}'", "viscous", "stribeck@0.1"):
            joint_law(wrong)
