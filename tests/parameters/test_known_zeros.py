"""Known zeros: a minimal set of the robots that have them, by three witnesses; none disagrees."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.dynamics.witnesses import verify, verify_drives
from testbed.parameters.barycentric import parameter_names
from testbed.parameters.elimination import eliminate
from testbed.parameters.entries import dense_rows, list_entries
from testbed.parameters.joint_terms import with_joint_terms
from testbed.parameters.minimal_set import MinimalSet
from testbed.parameters.regroup import regroup
from testbed.parameters.rules import Model
from testbed.robot.friction import LAWS
from testbed.robot.tree import Joint, Tree
from tests.helpers.paths import REAL
from tests.helpers.robots import random_robot, with_zeros

pytestmark = pytest.mark.slow

UNCHANGED = 1e-11  # relative change of the model by regrouping; lifts of short lengths are large
FILE_ROUNDING = 1e-8  # the same, for files whose angles are rounded: an axis almost vertical
MODELS: tuple[Model, ...] = ("dynamic", "reaction")
GRAVITIES = ((0.0, 0.0, -9.81), (2.97, -4.95, -7.93), (0.0, 0.0, 0.0))
HANDFUL = (
    "ur_description/urdf/ur3_robot.urdf",
    "ur_description/urdf/ur5_robot.urdf",
    "ur_description/urdf/ur10_robot.urdf",
    "kinova_description/robots/kinova.urdf",
    "iris_description/robots/iris.urdf",
    "double_pendulum_description/urdf/double_pendulum_simple.urdf",
    "finger_edu_description/robots/finger_edu.urdf",
)
LARGE = (
    "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "human_description/robots/human.urdf",
    "simple_humanoid_description/urdf/simple_humanoid.urdf",
    "icub_description/robots/icub_reduced.urdf",
)


def all_sets(tree: Tree, gravity: object, zeros: object) -> list[MinimalSet]:
    """Dynamic, bedplate and tared bedplate."""
    given = [("dynamic", False), ("reaction", False), ("reaction", True)]
    return [tb.minimal_set(tree, m, gravity, zeros, tared=t) for m, t in given]  # type: ignore[arg-type]


def hold(tree: Tree, gravity: object, zeros: object, change: float = UNCHANGED) -> None:
    """S lift = 1 within what is known, S between the models, three witnesses, the drives."""
    dynamic, *plates = all_sets(tree, gravity, zeros)
    for plate in plates:
        s = tb.selection(dynamic, plate)
        np.testing.assert_allclose(s @ plate.matrix, dynamic.matrix, atol=1e-9)
    for minimal in (dynamic, *plates):
        assert not minimal.lift[minimal.known_zero.ravel()].any()
        assert not minimal.matrix[:, minimal.known_zero.ravel()].any()
        found = verify(tree, minimal)
        assert found.holds, found
        assert found.change <= change
    drives = verify_drives(tree, with_joint_terms(tree, dynamic, LAWS))
    assert drives.holds, drives


@pytest.mark.parametrize("seed", range(20_000, 20_040))
def test_three_witnesses_agree_on_trees_of_bodies_with_zeros(seed: int) -> None:
    """Masses on axes, symmetric and massless links; `python -m benchmarks minimal` does more."""
    rng = np.random.default_rng(seed)
    tree = with_zeros(rng, random_robot(rng, int(rng.integers(1, 9)))).tree()
    hold(tree, GRAVITIES[seed % 3], True)


@pytest.mark.parametrize("seed", range(21_000, 21_030))
def test_three_witnesses_agree_on_any_list_of_zeros(seed: int) -> None:
    """Whether or not a body could have them: a list is a subspace."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, int(rng.integers(1, 9))).tree()
    share = rng.choice([0.05, 0.3, 0.7, 0.95])
    zeros = [name for name in parameter_names(tree) if rng.random() < share]
    hold(tree, GRAVITIES[seed % 3], zeros)


@pytest.mark.parametrize("robot", HANDFUL)
def test_three_witnesses_agree_on_real_robots(robot: str) -> None:
    tree = tb.load_tree(REAL / robot, weld_root=True)
    assert all_sets(tree, None, True)[0].known_zero.any()
    hold(tree, None, True, FILE_ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize("robot", LARGE)
def test_three_witnesses_agree_on_humanoids(robot: str) -> None:
    tree = tb.load_tree(REAL / robot, weld_root=True)
    hold(tree, None, True, FILE_ROUNDING)


@pytest.mark.parametrize("seed", range(20))
def test_zeros_tell_nothing_new(seed: int) -> None:
    """With zeros, the sets are no larger, and all known leaves nothing to be told."""
    rng = np.random.default_rng(seed)
    tree = with_zeros(rng, random_robot(rng, 6)).tree()
    for general, known in zip(all_sets(tree, None, False), all_sets(tree, None, True), strict=True):
        assert known.count <= general.count
        assert set(known.names) <= set(general.names)
    for nothing in all_sets(tree, None, parameter_names(tree)):
        assert nothing.count == 0
        assert nothing.lift.shape == (10 * tree.n, 0)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_dropped_is_the_combination_that_it_is_said_to_be(seed: int) -> None:
    """Of kept entries, on all parameters that are not known; the bedplate's entries, too."""
    rng = np.random.default_rng(seed)
    tree = with_zeros(rng, random_robot(rng, int(rng.integers(1, 9)))).tree()
    for model in MODELS:
        known = tb.minimal_set(tree, model, zeros=True).known_zero
        bodies = regroup(tree, model, tree.gravity)
        entries = list_entries(tree, bodies, model, tree.gravity, tared=False)
        found = eliminate(tree, bodies, entries, known)
        assert {*found.kept, *found.dependent} == set(range(len(entries)))
        rows = np.where(known.ravel(), 0.0, dense_rows(tree, bodies, entries))
        for dropped, shares in found.dependent.items():
            made = sum((share * rows[k] for k, share in shares.items()), np.zeros(10 * tree.n))
            np.testing.assert_allclose(rows[dropped], made, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_true_robot_is_among_those_told(seed: int) -> None:
    """Theta -> S theta -> lift leaves the values of all minimal parameters as they are."""
    rng = np.random.default_rng(seed)
    tree = with_zeros(rng, random_robot(rng, 7)).tree()
    for minimal in all_sets(tree, None, True):
        delta = minimal.values(tb.barycentric(tree))
        again = minimal.values(minimal.lift @ delta)
        np.testing.assert_allclose(again, delta, rtol=0, atol=1e-12 * max(1, np.abs(delta).max()))


def test_a_zero_that_a_child_fills_is_told_through_the_child() -> None:
    """The fault that UR robots showed: mb*1z = mb1z + mb2y with mb1z known to be zero."""
    y = np.eye(3)[1]
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # body 2's y is body 1's z
    joints = (
        Joint("a", "one", "revolute", -1, y, np.zeros(3), np.eye(3)),
        Joint("b", "two", "revolute", 0, y, np.array([0.0, 0.0, 0.4]), turn),
    )
    some = tb.Inertia.about_centre(1.0, np.array([0.1, 0.2, 0.3]), np.eye(3) * 0.1)
    tree = Tree("two", joints, (some, some))
    minimal = tb.minimal_set(tree, "dynamic", zeros=["mb1z"])
    k = minimal.names.index("mb*1z")
    column = minimal.lift[:, k].reshape(2, 10)
    assert str(minimal.formulas[k]) == "mb*1z = mb2y"
    assert column[0, 3] == 0.0
    assert column[1, 2] == 1.0
    hold(tree, None, ["mb1z"])


def test_moments_that_are_all_rounding_are_zero() -> None:
    """A file's zero may be 1e-17: small against a mass at a distance of the body's size."""
    inertia = tb.Inertia.about_centre(2.0, np.array([1e-17, 0.0, 0.0]), np.eye(3) * 0.1)
    joint = Joint("a", "one", "revolute", -1, np.eye(3)[2], np.zeros(3), np.eye(3))
    minimal = tb.minimal_set(Tree("one", (joint,), (inertia,)), "reaction", zeros=True)
    names = np.array(parameter_names(Tree("one", (joint,), (inertia,))))
    known = set(names[minimal.known_zero.ravel()].tolist())
    assert known == {"mb1x", "mb1y", "mb1z", "K1xy", "K1xz", "K1yz"}
