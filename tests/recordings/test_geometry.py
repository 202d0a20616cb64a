"""A recording knows the robot that it is of."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from testbed.errors import RecordingError
from testbed.recordings.geometry import TOLERANCE, check_robot, geometry
from testbed.recordings.recording import Recording
from tests.helpers.ideal import ideal
from tests.helpers.runs import robot


@pytest.fixture(scope="module")
def recording() -> Recording:
    return ideal(robot("gantry"), duration=2.0, rate=100.0)


def saying(recording: Recording, **changed: Any) -> Recording:
    """With other words about its first joint."""
    said = json.loads(json.dumps(geometry(robot("gantry"))))
    name = recording.names[0]
    said[name] |= changed
    return replace(recording, facts={"geometry": said})


def test_its_own_robot_is_known(recording: Recording) -> None:
    tree = robot("gantry")
    check_robot(recording, tree)
    check_robot(saying(recording), tree)
    check_robot(replace(recording, facts={}), tree)  # nothing is known beside the names
    first = tree.joints[0]
    near = [x + 0.5 * TOLERANCE for x in first.offset.tolist()]
    check_robot(saying(recording, offset=near), tree)


@pytest.mark.parametrize(
    ("what", "value"),
    [
        ("kind", "revolute"),
        ("parent", "elsewhere"),
        ("axis", [1.0, 0.0]),
        ("axis", [0.6, 0.8, 0.0]),
        ("offset", [9.0, 0.0, 0.0]),
        ("rotation", [[1.0, 0.0, 0.0]]),
    ],
)
def test_another_robot_is_refused_with_what_differs(
    what: str, value: object, recording: Recording
) -> None:
    tree = robot("gantry")
    with pytest.raises(RecordingError) as caught:
        check_robot(saying(recording, **{what: value}), tree)
    said = str(caught.value)
    assert said.startswith(f"the recording is of another robot: its joint '{tree.names[0]}' has")
    assert f"has {what} {json.dumps(value)}, the model has" in said


def test_joints_of_other_names_are_another_robots(recording: Recording) -> None:
    with pytest.raises(RecordingError, match="it has the joints .*, the model has"):
        check_robot(recording, robot("puma"))
