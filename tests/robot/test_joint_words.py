"""What is said of joints that cannot be, that are held oddly, or have what is not modelled."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.robot.locks import Travel
from testbed.robot.tree import FARTHEST
from tests.helpers.runs import robot

FLAWS: tuple[tuple[dict[str, Any], str], ...] = (
    ({"offset": np.array([np.nan, 0, 0])}, "a place or axis that is not a number"),
    ({"axis": np.array([0, 0, np.inf])}, "a place or axis that is not a number"),
    ({"offset": np.array([0, 2 * FARTHEST, 0])}, f"m is the limit|{FARTHEST:g} m"),
    ({"axis": np.array([0.0, 0.0, 1.1])}, r"no direction: its axis is \[0.0, 0.0, 1.1\]"),
    ({"position_range": (1.0, -1.0)}, "a range that ends before it begins: 1 to -1"),
    ({"coulomb": -0.5}, "coulomb -0.5, which is finite and not negative"),
    ({"viscous": math.inf}, "viscous inf, which is finite and not negative"),
    ({"rotor_inertia": -1e-3}, "rotor inertia -0.001, which is finite and not negative"),
    ({"max_velocity": 0.0}, "max velocity 0, which must be positive"),
    ({"max_effort": -1.0}, "max effort -1, which must be positive"),
)


@pytest.mark.parametrize(("values", "said"), FLAWS)
def test_a_joint_that_cannot_be_says_why(values: dict[str, Any], said: str) -> None:
    joint = replace(robot("puma").joints[0], **values)
    assert re.search(said, joint.flaw() or "")


def test_joints_at_the_edge_of_what_can_be_have_no_flaw() -> None:
    plain = robot("puma").joints[0]
    assert plain.flaw() is None
    for values in (
        {"offset": np.array([FARTHEST, 0, -FARTHEST])},
        {"position_range": (1.0, 1.0)},
        {"position_range": (-math.inf, math.inf)},
        {"coulomb": 0.0, "viscous": 0.0, "rotor_inertia": 0.0},
        {"max_velocity": math.inf, "max_effort": 1e-9},
    ):
        assert replace(plain, **values).flaw() is None


@pytest.mark.parametrize(
    ("low", "high", "rest"),
    [
        (-1.0, 2.0, 0.0),
        (0.0, 2.0, 0.0),
        (-2.0, 0.0, 0.0),
        (1.0, 2.0, 1.5),
        (-3.0, -2.0, -2.5),
        (0.5, math.inf, 0.5),
        (-math.inf, -0.5, -0.5),
        (-math.inf, math.inf, 0.0),
    ],
)
def test_joints_rest_at_zero_or_near_it(low: float, high: float, rest: float) -> None:
    assert Travel(low, high).rest == rest


FOLLOWERS = """<robot name="r">
  <link name="base"/>
  {links}
  <joint name="leads" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="follows" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
    <mimic joint="leads" multiplier="2" offset="0.1"/></joint>
  <joint name="free" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""
LINK = (
    '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
    'ixz="0" iyz="0"/></inertial></link>'
)


@pytest.mark.parametrize(
    ("lock", "said"),
    [
        ({"leads": 0.2, "follows": 0.5}, ""),
        ({"leads": 0.2, "follows": None}, ""),
        (
            {"leads": 0.2, "follows": 0.3},
            "joint 'follows' is held at 0.3, where 'leads' would take it to 0.5",
        ),
        ({"follows": 0.3}, "joint 'follows' follows 'leads', which moves; it is held at 0.3"),
    ],
)
def test_followers_that_are_held_elsewhere_are_named(
    lock: dict[str, float | None], said: str, tmp_path: Path
) -> None:
    links = "".join(map(LINK.format, "abc"))
    (tmp_path / "r.urdf").write_text(FOLLOWERS.format(links=links))
    assert tb.load_tree(tmp_path / "r.urdf", lock=lock).warnings == ((said,) if said else ())


MJCF = """<mujoco><worldbody><body name="b">
  <joint name="j" type="{kind}" axis="0 0 1" {more}/>
  <inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.01 0.01"/>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("kind", "more", "said"),
    [
        ("hinge", "", ""),
        ("hinge", 'damping="2"', ""),
        ("hinge", 'stiffness="3.5"', "left out: springs of 'j'"),
        ("slide", 'stiffness="7"', "left out: springs of 'j'"),
    ],
)
def test_springs_in_joints_are_not_modelled_and_said(
    kind: str, more: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "r.xml").write_text(MJCF.format(kind=kind, more=more))
    warnings = tb.load_tree(tmp_path / "r.xml").warnings
    assert len(warnings) == bool(said)
    assert all(line.startswith(said) for line in warnings)
