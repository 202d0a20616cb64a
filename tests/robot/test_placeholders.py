"""Numbers of model files that nobody measured are named before any data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.bodies.prior import prior_of
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.placeholders import find_placeholders
from tests.helpers.runs import robot

LINK = """<link name="{0}"><inertial><origin xyz="{1}"/><mass value="{2}"/>
<inertia ixx="{3}" ixy="0" ixz="0" iyy="{4}" iyz="0" izz="{5}"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>
<origin xyz="0 0 .3"/><axis xyz="{3}"/><limit lower="-1" upper="1" effort="9" velocity="9"/>
<dynamics damping="{4}" friction="{5}"/></joint>"""


def arm(
    bodies: dict[str, tuple[object, ...]], folder: Path, friction: tuple[tuple[float, float], ...]
) -> tb.Tree:
    """Arm of links one above the other."""
    names = [*bodies]
    links = [LINK.format(name, *each) for name, each in bodies.items()]
    joints = [
        JOINT.format(f"j{k}", before, name, ("1 0 0", "0 1 0")[k % 2], *friction[k])
        for k, (before, name) in enumerate(zip(["base", *names], names, strict=False))
    ]
    text = f'<robot name="arm"><link name="base"/>{"".join(links + joints)}</robot>'
    (folder / "arm.urdf").write_text(text)
    return tb.load_tree(folder / "arm.urdf")


TRUE = ("0 .01 .14", 2.31, 0.0192, 0.0188, 0.0041)
CASES = {
    "a power of ten about all axes": (".01 0 .1", 1.7, 0.01, 0.01, 0.01),
    "numbers of one digit": ("0 0 .1", 2, 0.02, 0.02, 0.03),
    "wider than its link": ("0 0 .1", 1.234, 0.912, 0.923, 0.1234),
    "lighter than foam": ("0 0 .1", 0.1234, 0.00912, 0.00923, 0.00934),
}


@pytest.mark.parametrize("case", CASES)
def test_a_body_that_nobody_measured_is_named(case: str, tmp_path: Path) -> None:
    """Alone: its neighbours are not, and its prior is wider."""
    friction = ((0.31, 1.2), (0.27, 0.9), (0.12, 0.4))
    tree = arm({"a": TRUE, "b": CASES[case], "c": TRUE}, tmp_path, friction)
    found = find_placeholders(tree)
    assert [*found.links] == ["b"]
    assert (found.bodies, dict(found.friction)) == ((1,), {})
    assert "'b'" in found.diagnostics[0].text
    assert prior_of(tree).placeholders.bodies == (1,)


def test_bodies_of_one_form_in_a_chain_are_named(tmp_path: Path) -> None:
    tree = arm(dict.fromkeys("abc", TRUE), tmp_path, ((0.31, 1.2), (0.27, 0.9), (0.12, 0.4)))
    assert [*find_placeholders(tree).links] == ["a", "b", "c"]


@pytest.mark.parametrize(
    ("friction", "named"),
    [
        (((10, 0.1),) * 3, {"viscous", "coulomb"}),
        (((0.31, 1.0), (0.27, 1.0), (0.12, 0.4)), {"coulomb"}),
        (((0.37, 1.23),) * 3, {"viscous", "coulomb"}),
        (((0.31, 1.2), (0.27, 0.9), (0.12, 0.4)), set()),
        (((0, 0),) * 3, set()),
    ],
)
def test_friction_that_nobody_measured_is_named(
    friction: tuple[tuple[float, float], ...], named: set[str], tmp_path: Path
) -> None:
    """One round number at most joints, or any one number at all of three."""
    other = ("0 .02 .11", 1.31, 0.0132, 0.0118, 0.0031)
    tree = arm({"a": TRUE, "b": other, "c": TRUE}, tmp_path, friction)
    assert set(find_placeholders(tree).friction) == named


def test_a_measured_robot_has_none() -> None:
    found = find_placeholders(robot("puma"))
    assert (found.links, found.friction, found.diagnostics) == ({}, {}, ())


def test_bodies_without_a_file_are_judged_as_they_are() -> None:
    tree = replace(robot("puma"), file=None)
    round_one = Inertia.about_centre(3.0, np.array([0, 0, 0.1]), 0.1 * np.eye(3))
    odd = replace(tree, inertias=(round_one, *tree.inertias[1:]))
    assert find_placeholders(odd).bodies == (0,)
