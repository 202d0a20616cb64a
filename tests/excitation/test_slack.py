"""What is left of limits at every instant is what the proof says of the whole motion."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.excitation.clearance import FAR, DistanceMeter
from testbed.excitation.collision_model import collision_model
from testbed.excitation.limit_terms import EffortTerm
from testbed.excitation.limits import limits_of, motor_efforts
from testbed.excitation.proof import Rules
from testbed.excitation.random_motion import random_motion
from testbed.excitation.slack import slack
from testbed.robot.visuals.appearance import load_appearance


@pytest.mark.parametrize("seed", range(3))
def test_every_kind_of_limit_has_its_nearest(seed: int, puma: tb.Tree) -> None:
    limits = limits_of(puma)
    motion = random_motion(puma, limits, 0.1, 4, np.random.default_rng(seed))
    collision = collision_model(puma, load_appearance(puma).shapes)
    least = np.where(np.arange(len(collision.pairs)) % 3 == 0, 0.004, 0.02)
    terms = (EffortTerm(puma, limits, 0.9),)
    times = np.linspace(0, motion.period, 60)
    found = slack(motion, Rules(puma, limits, 0.9, terms, collision, least), times)
    at, meter = motion.at(times), DistanceMeter(collision)
    nearest = np.array([meter.measure(q).values[least == 0.02].min() for q in at.q])
    kinds = [
        ("position limits", "%"),
        ("velocity limits", "%"),
        ("acceleration limits", "%"),
        ("effort limits", "%"),
        ("clearances", "mm"),
    ]
    shown = kinds if (nearest < FAR).any() else kinds[:-1]  # what never comes near is no row
    assert [(each.label, each.unit) for each in found] == shown
    middle, half = (limits.high + limits.low) / 2, (limits.high - limits.low) / 2
    wanted = [
        100 * (0.9 - (np.abs(at.q - middle) / half).max(axis=1)),
        100 * (0.9 - (np.abs(at.qd) / limits.velocity).max(axis=1)),
        100 * (0.9 - (np.abs(at.qdd) / limits.acceleration).max(axis=1)),
        None,
        1000 * (nearest - 0.02),
    ]
    for each, expected in zip(found, wanted, strict=False):
        if expected is not None:
            np.testing.assert_allclose(each.left, expected, atol=1e-9)
    used = (np.abs(motor_efforts(puma, at)) / limits.effort).max(axis=1)
    assert (found[3].left <= 100 * (0.9 - used) + 1e-9).all()
    assert np.abs(found[3].left - 100 * (0.9 - used)).max() < 20  # smooth friction, either sign
    assert len(slack(motion, Rules(puma, limits, 0.9, terms, None, np.zeros(0)), times)) == 4
