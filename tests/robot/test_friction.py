"""Laws of the joints' own torque: one value each, read by everybody."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.errors import UnknownName
from testbed.robot.friction import (
    COULOMB,
    LAWS,
    OFFSET,
    ROTOR,
    VISCOUS,
    drive_torque,
    friction_torque,
    joint_law,
    joint_terms,
)
from tests.helpers.robots import random_robot


def rubbing(seed: int) -> tb.Tree:
    """A random tree with friction and rotors."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 1 + seed % 6).tree()
    joints = [
        replace(j, coulomb=a, viscous=b, rotor_inertia=c)
        for j, (a, b, c) in zip(tree.joints, rng.uniform(0, 5, (tree.n, 3)), strict=True)
    ]
    return replace(tree, joints=tuple(joints))


@pytest.mark.parametrize("seed", range(6))
def test_torques_are_the_sum_of_the_laws(seed: int) -> None:
    """Written out once more, as in any textbook."""
    tree, rng = rubbing(seed), np.random.default_rng(seed)
    qd, qdd = rng.normal(size=(2, 50, tree.n))
    qd[0] = 0.0
    expected = np.zeros_like(qd)
    for k, joint in enumerate(tree.joints):
        expected[:, k] = joint.coulomb * np.sign(qd[:, k]) + joint.viscous * qd[:, k]
    np.testing.assert_allclose(friction_torque(tree, qd), expected, rtol=1e-15)
    rotors = np.array([joint.rotor_inertia for joint in tree.joints]) * qdd
    np.testing.assert_allclose(drive_torque(tree, qd, qdd), expected + rotors, rtol=1e-14)
    np.testing.assert_array_equal(friction_torque(tree, qd[7]), friction_torque(tree, qd)[7])
    assert not friction_torque(tree.without_friction(), qd).any()


def test_only_the_jump_is_smoothed() -> None:
    """Far from rest nothing changes; at rest there is no jump; viscous friction is as it was."""
    tree = rubbing(3)
    qd = np.linspace(-1, 1, 401)[:, None] * np.ones(tree.n)
    soft, hard = friction_torque(tree, qd, 0.05), friction_torque(tree, qd)
    fast = np.abs(qd) > 0.5
    np.testing.assert_allclose(soft[fast], hard[fast], rtol=1e-6)
    steps = np.abs(np.diff(soft, axis=0)).max(axis=0)
    assert (steps < 0.2 * np.array([joint.coulomb for joint in tree.joints]) + 0.05).all()
    wet = replace(tree, joints=tuple(replace(j, coulomb=0.0) for j in tree.joints))
    np.testing.assert_array_equal(friction_torque(wet, qd, 0.05), friction_torque(wet, qd))


def test_units_belong_to_the_kind_of_joint() -> None:
    tree = next(t for t in map(rubbing, range(20)) if len({j.kind for j in t.joints}) == 2)
    turning = {"coulomb": "N m", "viscous": "N m s/rad", "offset": "N m", "rotor": "kg m^2"}
    turning |= {"asymmetric": "N m s/rad", "quadratic": "N m s^2/rad^2"}
    turning |= {"square_root": "N m s^.5/rad^.5"}
    sliding = {"coulomb": "N", "viscous": "N s/m", "offset": "N", "rotor": "kg"}
    sliding |= {"asymmetric": "N s/m", "quadratic": "N s^2/m^2", "square_root": "N s^.5/m^.5"}
    for term in joint_terms(tree, LAWS):
        joint = tree.joints[term.joint]
        assert term.unit(tree) == (turning if joint.revolute else sliding)[term.law.kind]
        assert term.name(tree) == f"{term.law.kind}/{joint.name}"


def test_the_file_states_all_but_the_offset() -> None:
    tree = rubbing(4)
    for law, field in ((COULOMB, "coulomb"), (VISCOUS, "viscous"), (ROTOR, "rotor_inertia")):
        expected = [getattr(joint, field) for joint in tree.joints]
        np.testing.assert_array_equal(law.coefficients(tree), expected)
    assert not OFFSET.coefficients(tree).any()


def test_laws_are_found_by_name() -> None:
    assert [joint_law(law.kind) for law in LAWS] == list(LAWS)
    with pytest.raises(UnknownName, match="did you mean 'viscous'"):
        joint_law("viscos")
    assert joint_law("stribeck@0.08") is joint_law("stribeck@0.080")
    assert joint_law("stribeck@0.08").column(0.08, 0.0) == pytest.approx(np.exp(-1))
    for wrong in ("stribeck@", "stribeck@0", "stribeck@fast", "stribeck@-1", "stribeck@inf"):
        with pytest.raises(UnknownName, match=r"stribeck@0\.1"):
            joint_law(wrong)
