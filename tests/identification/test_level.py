"""A bedplate that leans is among the causes that are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.identification.trace_findings import LEVEL
from testbed.robot.rotations import about
from tests.helpers.ideal import ideal
from tests.helpers.runs import noisy, robot


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "ur5", "random"])
def test_a_plate_that_is_not_level_is_named(name: str) -> None:
    tree = robot(name)
    leaning = tree.with_gravity(about(np.array([1.0, 0, 0]), 0.02) @ tree.gravity)
    made = noisy(ideal(leaning, duration=20.0), size=0.02)
    facts = {**made.facts, "gravity": tree.gravity.tolist()}
    found = tb.identify(tree, replace(made, facts=facts))
    assert any(LEVEL in finding.causes for finding in found.findings)
    level = tb.identify(tree, noisy(ideal(tree, duration=20.0), size=0.02))
    assert not any(LEVEL in finding.causes for finding in level.findings)
