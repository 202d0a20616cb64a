"""What a motion may ask of a robot: the file's limits, the user's, and calm ones for the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import InfeasibleMotion, UnknownName
from testbed.excitation.limits import Limits, limits_of, motor_efforts, usage
from tests.helpers.robots import random_robot

CALM_RANGE = {"revolute": 2 * np.pi, "prismatic": 1.0}
CALM_SPEED = {"revolute": 2.0, "prismatic": 0.5}
CALM_ACCELERATION = {"revolute": 6.0, "prismatic": 2.0}
INF = np.inf


def some_tree(seed: int, n: int = 6) -> tb.Tree:
    return random_robot(np.random.default_rng(seed), n).tree()


def each(tree: tb.Tree, **changes: object) -> tb.Tree:
    """The tree with every joint changed alike."""
    return replace(tree, joints=tuple(replace(j, **changes) for j in tree.joints))  # type: ignore[arg-type]


def by_kind(tree: tb.Tree, values: dict[str, float]) -> Array:
    return np.array([values[joint.kind] for joint in tree.joints])


@pytest.mark.parametrize("seed", range(5))
def test_a_file_without_limits_gets_calm_ones_by_the_kind_of_joint(seed: int) -> None:
    tree = some_tree(seed)
    limits = limits_of(tree)
    np.testing.assert_allclose(limits.high - limits.low, by_kind(tree, CALM_RANGE))
    np.testing.assert_allclose(limits.low, -limits.high)
    np.testing.assert_array_equal(limits.velocity, by_kind(tree, CALM_SPEED))
    np.testing.assert_array_equal(limits.acceleration, by_kind(tree, CALM_ACCELERATION))
    np.testing.assert_array_equal(limits.effort, np.full(tree.n, INF))


@pytest.mark.parametrize("known", [(-0.3, 0.2), (0.4, 20.0), (-50.0, 40.0)])
def test_a_range_that_is_known_is_kept(known: tuple[float, float]) -> None:
    limits = limits_of(each(some_tree(0), position_range=np.array(known)))
    np.testing.assert_array_equal([limits.low, limits.high], np.outer(known, np.ones(6)))


@pytest.mark.parametrize("bound", [-7.0, -0.3, 0.0, 0.2, 7.0])
def test_a_range_with_one_end_is_as_wide_as_a_calm_one(bound: float) -> None:
    """It begins at the end that is known, or ends there; it is about zero where that may be."""
    tree = some_tree(1)
    half = by_kind(tree, CALM_RANGE) / 2
    above = limits_of(each(tree, position_range=np.array([bound, INF])))
    np.testing.assert_array_equal(above.low, np.full(6, bound))
    np.testing.assert_allclose(above.high, bound + 2 * half)
    below = limits_of(each(tree, position_range=np.array([-INF, bound])))
    np.testing.assert_allclose(below.high, np.minimum(bound, half))
    np.testing.assert_allclose(below.low, below.high - 2 * half)


def test_the_lower_of_two_speeds_counts() -> None:
    tree = each(some_tree(2), max_velocity=1.5)
    first, second, *_ = tree.names
    limits = limits_of(tree, {first: 0.2, second: 9.0}, {second: 0.7})
    assert limits.velocity.tolist() == [0.2, 1.5, 1.5, 1.5, 1.5, 1.5]
    calm = by_kind(tree, CALM_ACCELERATION)
    assert limits.acceleration.tolist() == [calm[0], 0.7, *calm[2:]]


def test_a_limit_for_a_joint_that_is_not_there_is_refused(puma: tb.Tree) -> None:
    with pytest.raises(UnknownName, match="wrist"):
        limits_of(puma, {"wrist": 1.0})
    with pytest.raises(UnknownName, match="wrist"):
        limits_of(puma, None, {"wrist": 1.0})


def test_a_joint_without_room_is_named(puma: tb.Tree) -> None:
    joints = (*puma.joints[:2], replace(puma.joints[2], position_range=np.array([0.3, 0.3])))
    with pytest.raises(InfeasibleMotion, match=r"'elbow' has no room to move: 0\.3 to 0\.3"):
        limits_of(replace(puma, joints=joints))


@pytest.mark.parametrize("seed", range(5))
def test_usage_is_the_largest_share_of_each_limit(seed: int) -> None:
    """A motion through random states, and limits that these use to a known share."""
    rng = np.random.default_rng(seed)
    tree = some_tree(seed)
    motion = tb.Motion(np.arange(20.0), *rng.normal(size=(3, 20, tree.n)))
    share = rng.uniform(0.2, 3.0, (4, tree.n))
    efforts = np.abs(motor_efforts(tree, motion)).max(axis=0)
    middle = rng.normal(size=tree.n)
    half = np.abs(motion.q - middle).max(axis=0) / share[0]
    limits = Limits(
        low=middle - half,
        high=middle + half,
        velocity=np.abs(motion.qd).max(axis=0) / share[1],
        acceleration=np.abs(motion.qdd).max(axis=0) / share[2],
        effort=efforts / share[3],
    )
    used = usage(tree, motion, limits)
    names = ("position", "velocity", "acceleration", "effort")
    assert tuple(used) == names
    for name, expected in zip(names, share, strict=True):
        np.testing.assert_allclose(used[name], expected, rtol=1e-12)


def test_motors_also_move_their_rotors_and_what_rubs() -> None:
    """Rotors add their inertia to the joint's own, losses brake."""
    rng = np.random.default_rng(0)
    tree = some_tree(3)
    motion = tb.Motion(np.arange(20.0), *rng.normal(size=(3, 20, tree.n)))
    bare = motor_efforts(tree, motion)
    np.testing.assert_array_equal(bare, tb.joint_forces(tree, motion))
    with_rotors = motor_efforts(each(tree, rotor_inertia=0.3), motion)
    np.testing.assert_allclose(with_rotors - bare, 0.3 * motion.qdd, atol=1e-12)
    rubbing = motor_efforts(each(tree, coulomb=0.7, viscous=0.1), motion) - bare
    np.testing.assert_allclose(rubbing, 0.7 * np.sign(motion.qd) + 0.1 * motion.qd, atol=1e-12)
