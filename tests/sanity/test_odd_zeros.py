"""Zeros by any angle are found, and named with their joint and the cure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from testbed.sanity.sanity import check_sanity
from tests.helpers.measured import measured
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
