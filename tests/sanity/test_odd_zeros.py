"""Zeros by any angle are found, and named with joint and cure; what is certain is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.sanity.sanity import check_sanity
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT
from tests.helpers.runs import robot, without

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("name", "joint", "degrees", "seconds", "within"),
    [
        ("puma", 1, 37.0, 30.0, 2.0),
        ("puma", 1, -110.0, 30.0, 2.0),
        ("ur5", 2, -53.0, 8.0, 2.0),
        ("ur5", 3, 40.0, 8.0, 2.0),
        ("puma, torques", 1, 75.0, 8.0, 20.0),
        ("puma, torques", 1, 160.0, 8.0, 25.0),
    ],
)
def test_a_zero_between_those_that_are_tried_is_found(
    name: str, joint: int, degrees: float, seconds: float, within: float
) -> None:
    """By a plate to a degree or two; without one to what rough masses tell."""
    tree = robot(name.partition(",")[0])
    recording = measured(tree, 4, duration=seconds)
    if "torques" in name:
        recording = without(recording, "wrench")
    position = np.array(recording.position)
    position[:, joint] -= np.deg2rad(degrees)
    found = check_sanity(tree, replace(recording, position=position))
    assert found.certain
    (cure,) = found.cures
    assert (cure.kind, cure.joints) == ("zero", (tree.names[joint],))
    ((table, key, offset),) = cure.lines
    assert (table, key) == ("position", "offset")
    assert np.rad2deg(offset[joint]) == pytest.approx(degrees, abs=within)
    assert not np.delete(offset, joint).any()


@pytest.mark.parametrize(("name", "joint"), [("puma", 1), ("ur5", 4)])
def test_a_zero_near_a_quarter_turn_is_found_or_said_not_to_be_told_from_it(
    name: str, joint: int
) -> None:
    """8 s, in which 20 degrees are worth a few nats."""
    recording = measured(robot(name), 4, duration=8.0)
    position = np.array(recording.position)
    position[:, joint] -= np.deg2rad(-110)
    found = check_sanity(robot(name), replace(recording, position=position))
    (cure,), (said,) = found.cures, found.certain
    assert cure.kind == "zero"
    near = f"{robot(name).names[joint]} by -11"
    assert abs(np.rad2deg(cure.values[0]) + 110) < 5 or near in said.found.partition("tell")[2]


@pytest.mark.parametrize("degrees", [90, -90, 180])
@pytest.mark.parametrize("joint", [1, 2, 3, 4])
def test_what_is_certain_of_a_real_robot_is_right(joint: int, degrees: float) -> None:
    """The TX40's wrist tells little of its zeros by its torques: then nothing is certain."""
    tree = tb.load_tree(ROOT / "examples/tx40/tx40.urdf")
    recording = tb.Recording.from_mapping(ROOT / "examples/tx40/tx40.toml")
    position = np.array(recording.position)
    position[:, joint] += np.deg2rad(degrees)
    found = check_sanity(tree, replace(recording, position=position))
    if found.certain:
        assert [(cure.kind, cure.joints) for cure in found.cures] == [
            ("zero", (tree.names[joint],))
        ]
        turned = np.exp(1j * (found.cures[0].values[0] + np.deg2rad(degrees)))
        assert abs(turned - 1) < 1e-3
