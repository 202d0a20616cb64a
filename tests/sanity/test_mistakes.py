"""Which mistakes of a mapping are tried: those that a robot's joints can have."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.robot.free_base import FREE, coordinates, on_free_base, poses
from testbed.sanity.mistakes import (
    BEYOND,
    Mistake,
    Signals,
    mistakes_of_all,
    mistakes_of_joints,
    rarer_mistakes,
)
from tests.helpers.paths import GOLDEN

ANGLES = {"degrees", "radians", "zero"}
TIMES = {"position_sign": -1.0, "degrees": 180 / np.pi, "radians": np.pi / 180}
ORDERS = {"position_order", "torque_order", "joint_order"}
ARMS = ("gantry_ppp_rrr", "stanford", "scara_rrpr")
"""With joints that slide and joints that turn."""


def arm(name: str) -> tb.Tree:
    return tb.load_tree(GOLDEN / f"robots/{name}.urdf")


def signals(tree: tb.Tree, size: float) -> Signals:
    """Of positions about as large."""
    rng = np.random.default_rng(3)
    position = size * rng.uniform(-1.0, 1.0, (50, tree.n))
    return Signals(position, rng.standard_normal((50, tree.n)), rng.standard_normal((50, 6)))


def tried(tree: tb.Tree, given: Signals) -> Iterator[Mistake]:
    """All that may be tried where every joint is doubted."""
    everyone = range(tree.n)
    yield from mistakes_of_all(tree, given)
    yield from mistakes_of_joints(tree, given, everyone)
    yield from rarer_mistakes(tree, everyone)


@pytest.mark.parametrize("size", [0.1, 10.0 * BEYOND])
@pytest.mark.parametrize("name", ARMS)
def test_what_slides_has_no_angles_and_changes_place_with_what_slides(
    name: str, size: float
) -> None:
    tree = arm(name)
    turning = {k for k, joint in enumerate(tree.joints) if joint.revolute}
    concerned = set()
    for mistake in tried(tree, signals(tree, size)):
        if mistake.kind in ANGLES:
            assert turning.issuperset(mistake.joints), mistake
            concerned |= set(mistake.joints)
        if mistake.kind in ORDERS:
            kinds = [tree.joints[k].kind for k in mistake.order]
            assert kinds == [joint.kind for joint in tree.joints], mistake
    assert concerned == turning


@pytest.mark.parametrize("name", ARMS)
def test_units_of_angles_are_doubted_where_angles_are_very_large_or_very_small(name: str) -> None:
    """Of joints that slide they are not looked at."""
    tree = arm(name)
    slides = np.array([not joint.revolute for joint in tree.joints])
    for size, expected in ((0.05, {"radians"}), (2.0, set()), (300.0, {"degrees"})):
        for other in (0.05, 2.0, 300.0):
            given = signals(tree, 1.0)
            given.position[:] *= np.where(slides, other, size)
            assert {m.kind for m in tried(tree, given)} & {"degrees", "radians"} == expected


def spoilt_joints(mistake: Mistake, true: Signals) -> tuple[Array, Array]:
    """Positions and torques with a mistake, a column after the other."""
    position, torque = np.array(true.position), np.array(true.torque)
    for joint, angle in zip_longest(mistake.joints, mistake.angles, fillvalue=0):
        column, whole = position[:, int(joint)], torque[:, int(joint)]
        if mistake.kind == "zero":
            column -= angle
        if mistake.kind == "torque_sign":
            whole *= -1
        column *= TIMES.get(mistake.kind, 1.0)
    for k, place in enumerate(mistake.order):
        if mistake.kind in ("position_order", "joint_order"):
            position[:, place] = true.position[:, k]
        if mistake.kind in ("torque_order", "joint_order"):
            torque[:, place] = np.array(true.torque)[:, k]
    return position, torque


def spoilt_plate(mistake: Mistake, true: Signals) -> Array:
    """A wrench with a mistake, a channel after the other."""
    whole = np.array(true.wrench)
    wrench = whole.copy()
    if mistake.kind == "plate_order":
        for k, place in enumerate(mistake.order):
            wrench[:, place] = whole[:, k]
    for channel in range(6):
        unit = "force_unit" if channel < 3 else "moment_unit"
        wrench[:, channel] *= mistake.factor if mistake.kind == unit else 1.0
        wrench[:, channel] *= -1.0 if mistake.kind == "wrench_sense" else 1.0
    return wrench


@pytest.mark.parametrize("name", ARMS)
def test_a_mistake_that_was_made_is_undone(name: str) -> None:
    tree = arm(name)
    true = signals(tree, 1.0)
    for size in (0.05, 1.0, 300.0):
        for mistake in tried(tree, signals(tree, size)):
            made = Signals(*spoilt_joints(mistake, true), spoilt_plate(mistake, true))
            undone = mistake.undone(made)
            for now, was in zip(vars(undone).values(), vars(true).values(), strict=True):
                np.testing.assert_allclose(now, was, rtol=1e-12, atol=1e-14, err_msg=str(mistake))


def test_a_bases_mistakes_are_undone() -> None:
    """Units of its place, and the order of its quaternion's parts."""
    tree = on_free_base(arm("stanford"))
    rng = np.random.default_rng(4)
    true = Signals(rng.uniform(-1, 1, (50, tree.n)), None, rng.standard_normal((50, 6)))
    found = [m for m in mistakes_of_all(tree, true) if m.kind in ("base_unit", "quaternion_order")]
    assert [m.kind for m in found] == ["base_unit"] * 4 + ["quaternion_order"]
    for mistake in found:
        position = true.position.copy()
        if mistake.kind == "base_unit":
            position[:, :3] *= mistake.factor
        else:
            pose = poses(position[:, :FREE])
            pose[:, 3:] = pose[:, [4, 5, 6, 3]]  # x, y, z, w
            position[:, :FREE] = coordinates(pose)
        undone = mistake.undone(Signals(position, None, true.wrench)).position
        np.testing.assert_allclose(
            poses(undone[:, :FREE]), poses(true.position[:, :FREE]), atol=1e-12
        )
        np.testing.assert_array_equal(undone[:, FREE:], true.position[:, FREE:])
