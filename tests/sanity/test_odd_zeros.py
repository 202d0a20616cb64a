"""Zeros by any angle are found, and named with their joint and the cure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from testbed.sanity.sanity import check_sanity
from tests.helpers.measured import measured
from tests.helpers.runs import robot

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("joint", "degrees", "within"), [(1, 37.0, 4.0), (2, -53.0, 7.5), (1, -110.0, 4.0)]
)
def test_a_zero_between_those_that_are_tried_is_found(
    joint: int, degrees: float, within: float
) -> None:
    """Those tried are 15 degrees apart; the lighter what the joint carries, the less it tells."""
    tree = robot("puma")
    recording = measured(tree, 4, duration=8.0)
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
