"""What does not move tells nothing, and that is said."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from testbed.sanity.sanity import check_sanity
from tests.helpers.measured import measured
from tests.helpers.runs import robot


def test_a_robot_at_rest_is_neither_refused_nor_cured() -> None:
    recording = measured(robot("ur5"), 4, duration=8.0)
    still: dict[str, Any] = {
        name: np.repeat(np.asarray(getattr(recording, name))[:1], recording.samples, axis=0)
        for name in ("position", "torque", "wrench")
    }
    found = check_sanity(robot("ur5"), replace(recording, **still))
    assert (found.certain, found.cures) == ((), ())
    assert [each.subject for each in found.likely] == ["the robot"]


def test_a_plate_that_shows_one_value_is_no_plate_with_crosstalk() -> None:
    recording = measured(robot("ur5"), 4, duration=8.0)
    wrench = np.repeat(np.asarray(recording.wrench)[:1], recording.samples, axis=0)
    found = check_sanity(robot("ur5"), replace(recording, wrench=wrench))
    assert [each.causes[0] for each in found.certain] == ["columns that are not the plate's"]
    assert found.cures == ()
