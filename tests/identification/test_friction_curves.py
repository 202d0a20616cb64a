"""Friction over velocity, no law assumed; terms chosen by data that a fit has not seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.identification.drive_findings import DriveFindings, identify_drives
from testbed.identification.friction_curves import NODES, friction_curves
from testbed.recordings.recording import Recording
from testbed.robot.friction import COULOMB, QUADRATIC, SQUARE_ROOT, VISCOUS, JointLaw, stribeck
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.measured import measured
from tests.helpers.runs import robot

ROBOTS = ("puma", "ur5", "gantry")


def rubbed(
    tree: tb.Tree, recording: Recording, law: JointLaw, size: float, scale: float = 1.0
) -> Recording:
    """A recording with more friction, of any law, and drives that report too much."""
    truth = recording.truth
    if truth is None:  # as `measured` makes it: speeds by differences, smooth enough for friction
        speed = np.gradient(recording.position, 1 / recording.rate, axis=0)
        kernel = np.hanning(21) / np.hanning(21).sum()
        speed = np.column_stack([np.convolve(each, kernel, "same") for each in speed.T])
    else:
        speed = truth.velocity
    torque = recording.measured("torque") + size * law.column(speed, 0 * speed)
    return replace(recording, torque=scale * torque)


def findings(
    tree: tb.Tree, recording: Recording, settings: tb.Settings, choose: bool = False
) -> DriveFindings:
    bodies = tb.identify(tree, recording, settings=settings)
    return identify_drives(tree, recording, bodies, settings=settings, choose=choose)


def plain_law(tree: tb.Tree, joint: int, speed: Array) -> Array:
    dry, wet = COULOMB.coefficients(tree)[joint], VISCOUS.coefficients(tree)[joint]
    return np.asarray(dry * np.sign(speed) + wet * speed)


def with_friction(name: str) -> tb.Tree:
    tree = robot(name)
    more = {n: {"coulomb": 3.0 + k, "viscous": 2.0} for k, n in enumerate(tree.names)}
    return tree.with_joints(more)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_exact_data_give_the_law_at_every_node(name: str) -> None:
    """Dry and viscous friction is straight between nodes: the curve is exact, at any scale."""
    tree = with_friction(name)
    recording = replace(ideal(tree, 20.0), torque=1.07 * ideal(tree, 20.0).measured("torque"))
    for joint, curve in enumerate(findings(tree, recording, EXACT).curves):
        assert curve.constant == pytest.approx(1.07, rel=1e-6)
        moving = curve.speed != 0
        want = plain_law(tree, joint, curve.speed[moving])
        np.testing.assert_allclose(curve.torque[moving], want, rtol=1e-5, atol=1e-6)
        assert len(curve.speed) > 6
        assert set(np.abs(curve.speed)) <= set(NODES)
        assert (np.diff(curve.speed) >= 0).all()


@pytest.mark.slow
def test_too_few_rows_at_every_speed_make_no_curve() -> None:
    tree = with_friction("puma")
    bodies = tb.identify(tree, measured(tree))
    for curve in friction_curves(tree, measured(tree, 3, duration=2.0), bodies):
        assert len(curve.speed) == len(curve.torque) == 0
        assert not curve.at(np.linspace(-1, 1, 5)).any()


@pytest.mark.slow
def test_curves_hold_within_their_sigmas() -> None:
    tree, scores = with_friction("puma"), []
    for seed in range(3):
        found = findings(tree, measured(tree, seed, duration=30.0), tb.Settings())
        for joint, curve in enumerate(found.curves):
            moving = np.abs(curve.speed) > 0.02
            off = curve.torque[moving] - plain_law(tree, joint, curve.speed[moving])
            assert np.sqrt(np.mean(off**2)) < 0.1  # N m
            scores.append(off / curve.sigma[moving])
    every = np.concatenate(scores)
    assert np.abs(every).max() < 5
    assert 0.6 < np.sqrt(np.mean(every**2)) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("law", [QUADRATIC, SQUARE_ROOT, stribeck(0.28)], ids=lambda law: law.kind)
def test_the_law_that_is_there_is_chosen(law: JointLaw) -> None:
    tree = with_friction("puma")
    recording = rubbed(tree, ideal(tree, 20.0), law, 1.5)
    rng = np.random.default_rng(1)
    torque = recording.measured("torque")
    noisy = replace(recording, torque=torque + 0.02 * rng.normal(size=torque.shape))
    found = findings(tree, noisy, EXACT, choose=True)
    family = law.kind.partition("@")[0]
    for drive in found.estimates:
        assert drive.choice is not None
        kinds = [step.kind.partition("@")[0] for step in drive.choice.steps]
        assert kinds[:2] == ["", family]
        assert all(step.gain > 2 for step in drive.choice.steps[1:])
        first = next(t for t in drive.terms if t.law.kind.startswith(family))
        assert first.value == pytest.approx(1.5, abs=0.5)


@pytest.mark.slow
def test_nothing_is_added_where_nothing_is() -> None:
    """Dry and viscous friction alone: of 18 choices one may err."""
    tree = with_friction("puma")
    added = 0
    for seed in range(6):
        found = findings(tree, measured(tree, 40 + seed), tb.Settings(), choose=True)
        for drive in found.estimates:
            assert drive.choice is not None
            added += len(drive.choice.steps) > 1
    assert added <= 3


def test_the_speed_at_which_friction_fades_is_found() -> None:
    """By an outer loop of the internal estimate, for all joints alike."""
    tree = with_friction("puma")
    recording = rubbed(tree, ideal(tree, 20.0), stribeck(0.2), 2.0)
    settings = replace(EXACT, terms=("coulomb", "viscous", "stribeck"))
    found = tb.identify(tree, recording, "internal", settings=settings)
    named = [name for name in found.names if name.startswith("stribeck@")]
    assert len(named) == tree.n
    speed = float(named[0].partition("@")[2].partition("/")[0])
    assert speed == pytest.approx(0.2, rel=0.1)
    truth = tb.minimal_set(tree, "dynamic").values(tb.barycentric(tree))
    np.testing.assert_allclose(found.base.values, truth, rtol=2e-2, atol=2e-2)
