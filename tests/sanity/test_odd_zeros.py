"""Zeros by any angle are found by rough masses; a plate without them is explained by others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from testbed.sanity.sanity import check_sanity
from tests.helpers.measured import measured
from tests.helpers.runs import robot, without

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("joint", "degrees", "within"), [(1, 75.0, 20.0), (1, 160.0, 25.0), (1, -110.0, 25.0)]
)
def test_a_zero_between_those_that_are_tried_is_found(
    joint: int, degrees: float, within: float
) -> None:
    """To what rough masses tell: the nearest quarter is taken where it explains about as much."""
    tree = robot("puma")
    recording = without(measured(tree, 4, duration=8.0), "wrench")
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
