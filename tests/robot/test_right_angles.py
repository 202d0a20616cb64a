"""Right angles that a file's digits round are right angles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.core.robot.right_angles import with_right_angles
from tests.helpers.strategies import few

BODY = """<body name="{0}" pos=".1 .02 .2" {1}><inertial pos=".02 .03 .1" mass="3"
fullinertia=".05 .06 .03 .001 .002 .003"/><joint name="{0}" axis="{2}" range="-3 3"/>"""


def robot_of(turns: list[tuple[int, ...]], axes: list[int], digits: int, folder: Path) -> tb.Tree:
    """Chain whose frames turn by multiples of a right angle, to so many digits."""
    bodies = []
    for k, (turn, axis) in enumerate(zip(turns, axes, strict=True)):
        angles = " ".join(f"{each * np.pi / 2:.{digits}f}" for each in turn)
        bodies.append(
            BODY.format(f"j{k}", f'euler="{angles}"', " ".join(map(str, np.eye(3)[axis])))
        )
    text = f"""<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{"".join(bodies)}
        {"</body>" * len(bodies)}</worldbody></mujoco>"""
    (folder / "robot.xml").write_text(text)
    return tb.load_tree(folder / "robot.xml")


quarters = st.tuples(*[st.integers(-1, 2)] * 3)
chains = st.lists(st.tuples(quarters, st.integers(0, 2)), min_size=2, max_size=4)


@given(chains, st.integers(5, 9))
@few(10)
def test_digits_do_not_change_what_can_be_identified(
    tmp_path_factory: pytest.TempPathFactory,
    chain: list[tuple[tuple[int, ...], int]],
    digits: int,
) -> None:
    """Witness: the same file with all digits."""
    folder = tmp_path_factory.mktemp("robot")
    turns, axes = [each for each, _ in chain], [each for _, each in chain]
    exact, rounded = (robot_of(turns, axes, each, folder) for each in (16, digits))
    assert not exact.diagnostics
    for kind in ("torque", "wrench"):
        sets = [tb.minimal_set(tree, kind) for tree in (exact, rounded)]
        assert sets[0].names == sets[1].names
        np.testing.assert_allclose(sets[0].matrix, sets[1].matrix, atol=1e-4)


def test_another_angle_stays_as_it_is(tmp_path: Path) -> None:
    tree = robot_of([(0, 0, 0), (1, 0, 0)], [2, 2], 2, tmp_path)  # 1.57: 8e-4 rad off
    assert with_right_angles(tree) is tree
    assert not tree.diagnostics
