"""What is tried for what robots, and that each mistake that was made is undone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.robot.free_base import on_free_base
from testbed.robot.rotations import from_rpy, from_vector
from testbed.sanity.cures import frame_of, lines_of, with_lines
from testbed.sanity.mistakes import (
    BEYOND,
    Mistake,
    joint_map,
    merged,
    plain_hypotheses,
    position_hypotheses,
    rarer_hypotheses,
)
from testbed.sanity.plate_map import both, placed, quarter_turns
from tests.helpers.paths import GOLDEN

ARMS = ("ur5", "gantry_ppp_rrr", "stanford", "scara_rrpr")
RIGHT: dict[str, Any] = {
    "source": "log",
    "columns": ["Fx", "Fy", "Fz", "Mx", "My", "Mz"],
    "units": ["N", "N m"],
    "sense": "on_robot",
}


def arm(name: str) -> tb.Tree:
    return tb.load_tree(GOLDEN / f"robots/{name}.urdf")


def positions(tree: tb.Tree, size: float) -> Array:
    return size * np.random.default_rng(2).uniform(-1, 1, (50, tree.n))


def test_the_quarter_turns_are_the_group_of_proper_ones() -> None:
    """24, each a rotation, closed under products: no reflection is among them."""
    turns = quarter_turns()
    assert {round(float(np.linalg.det(turn))) for turn in turns} == {1}
    names = {tuple(turn.ravel().tolist()) for turn in turns}
    assert len(names) == 24
    assert {tuple((a @ b).ravel().tolist()) for a in turns for b in turns} == names


@pytest.mark.parametrize("size", [0.1, 10.0 * BEYOND])
@pytest.mark.parametrize("name", ARMS)
def test_what_slides_has_no_angles_and_changes_place_with_what_slides(
    name: str, size: float
) -> None:
    tree = arm(name)
    turning = {k for k, joint in enumerate(tree.joints) if joint.revolute}
    tried = [
        *position_hypotheses(tree, positions(tree, size), ()),
        *rarer_hypotheses(tree, pairs=True),
    ]
    for mistake in tried:
        if mistake.kind in ("degrees", "radians", "zero"):
            assert turning.issuperset(mistake.joints), mistake
        if mistake.kind == "position_order":
            kinds = [tree.joints[k].kind for k in mistake.values]
            assert kinds == [joint.kind for joint in tree.joints], mistake
    signs = [m.joints for m in tried if m.kind == "position_sign"]
    assert signs == [(k,) for k in range(tree.n)]


@pytest.mark.parametrize("name", ARMS)
def test_units_of_angles_are_doubted_where_angles_are_very_large_or_very_small(name: str) -> None:
    """Of joints that slide they are not looked at."""
    tree = arm(name)
    slides = np.array([not joint.revolute for joint in tree.joints])
    for size, expected in ((0.05, {"radians"}), (2.0, set()), (300.0, {"degrees"})):
        for other in (0.05, 2.0, 300.0):
            given = positions(tree, 1.0) * np.where(slides, other, size)
            kinds = {m.kind for m in position_hypotheses(tree, given, ())}
            assert kinds & {"degrees", "radians"} == expected


@pytest.mark.parametrize("seed", range(20))
def test_any_order_of_signs_and_zeros_is_one_line_each(seed: int) -> None:
    """Positions without several mistakes, one by one, are those without the merged ones."""
    rng = np.random.default_rng(seed)
    tree = arm("ur5")
    zero = np.zeros(tree.n)
    made = []
    for _ in range(4):
        joint = (int(rng.integers(tree.n)),)
        turned = Mistake("zero", joint, (float(rng.choice([-1.5, 0.5])),))
        made.append(turned if rng.random() < 0.5 else Mistake("position_sign", joint))

    def undone(mistakes: list[Mistake]) -> Array:
        position = positions(tree, 1.0)
        for each in mistakes:
            scale, added = joint_map(each, tree.n, zero)
            position = position @ scale.T + added
        return position

    found = merged(made)
    assert len({each.kind for each in found}) == len(found)
    np.testing.assert_allclose(undone(list(found)), undone(made), atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_a_plates_lines_are_the_map_that_was_judged(seed: int) -> None:
    """The mapping with the lines makes of the file what the map makes of the recording."""
    from testbed.recordings.importing.mapping import WrenchTable
    from testbed.recordings.importing.signal_maps import bedplate_wrench

    rng = np.random.default_rng(seed)
    rpy = (0.0, 0.0, 0.0) if seed % 2 else (0.3, -0.2, 1.1)
    given = {
        **RIGHT,
        "units": ["lbf", "N mm"],
        "place": {"xyz": [0.1, -0.2, 0.3], "rpy": list(rpy)},
    }
    mapping: dict[str, Any] = {"wrench": given}
    several = list(plain_hypotheses(frame_of(mapping)))
    columns = rng.normal(size=(5, 6))
    by_name = dict(zip(RIGHT["columns"], columns.T, strict=True))

    def made(table: Mapping[str, Any]) -> Array:
        read = WrenchTable.model_validate(table)
        return bedplate_wrench(read, np.column_stack([by_name[name] for name in read.columns]))

    for k in rng.choice(len(several), 40, replace=False):
        mistakes, each = several[k]
        said = mapping
        for lines in lines_of(arm("ur5"), mistakes, mapping).values():
            said = with_lines(said, lines)
        wanted = made(given) @ each.T
        np.testing.assert_allclose(
            made(said["wrench"]), wanted, rtol=1e-4, atol=1e-4 * np.abs(wanted).max()
        )


def test_a_shift_of_the_frame_moves_moments_alone() -> None:
    turn, place = from_vector(np.array([0.2, 1.0, -0.4])), np.array([0.1, 0.2, -0.3])
    wrench = np.arange(1.0, 7.0)
    force, moment = turn @ wrench[:3], turn @ wrench[3:]
    wanted = np.r_[force, moment + np.cross(place, force)]
    np.testing.assert_allclose(placed(turn, place) @ wrench, wanted, atol=1e-12)
    np.testing.assert_allclose(both(turn) @ wrench, np.r_[force, moment], atol=1e-12)
    assert np.linalg.det(from_rpy((0.1, 0.2, 0.3))) == pytest.approx(1.0)


def test_a_base_that_moves_has_its_own_mistakes() -> None:
    tree = on_free_base(arm("stanford"))
    kinds = [m.kind for m in position_hypotheses(tree, positions(tree, 1.0), ())]
    assert kinds.count("base_unit") == 4
    assert kinds.count("quaternion_order") == 1
    assert kinds.count("position_sign") == tree.n - 6
