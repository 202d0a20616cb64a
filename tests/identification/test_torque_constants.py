"""Drives held against the plate: torque constants, rotors, friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import RecordingError, SettingsError
from testbed.identification.combined import combined
from testbed.identification.drive_findings import identify_drives
from testbed.identification.drive_regression import regressions, torques_beside
from testbed.identification.estimate import Estimate
from testbed.identification.torque_constants import DriveEstimate
from testbed.recordings.recording import Recording
from testbed.robot.friction import LAWS
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.measured import measured
from tests.helpers.runs import ROBOTS, robot, without

TERMS = ("coulomb", "viscous", "rotor")
SETTINGS = tb.Settings(terms=TERMS)


def driven(name: str) -> tb.Tree:
    """A robot with friction and rotors at every joint."""
    tree = robot(name)
    joints = (
        replace(j, coulomb=3.0 + k, viscous=2.0 + k, rotor_inertia=0.1 + 0.1 * k)
        for k, j in enumerate(tree.joints)
    )
    return replace(tree, joints=tuple(joints))


def constants(tree: tb.Tree) -> Array:
    """Up to 8 % off."""
    return np.asarray(1 + 0.08 * np.sin(1.0 + np.arange(tree.n)))


def reported(tree: tb.Tree, recording: Recording) -> Recording:
    return replace(recording, torque=recording.measured("torque") * constants(tree))


def drive_estimates(
    tree: tb.Tree, recording: Recording, bodies: Estimate, settings: tb.Settings | None = None
) -> tuple[DriveEstimate, ...]:
    return identify_drives(tree, recording, bodies, settings=settings).estimates


def numbers(found: DriveEstimate) -> tuple[Array, Array]:
    values = [found.constant, *(term.value for term in found.terms)]
    return np.array(values), np.array([found.sigma, *(term.sigma for term in found.terms)])


def truths(tree: tb.Tree, joint: int) -> Array:
    each = tree.joints[joint]
    return np.array([constants(tree)[joint], each.coulomb, each.viscous, each.rotor_inertia])


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_constants_friction_and_rotors_within_their_sigmas(name: str) -> None:
    tree, scores = driven(name), []
    for seed in range(2):
        recording = reported(tree, measured(tree, seed, duration=30.0))
        bodies = tb.identify(tree, recording, settings=SETTINGS)
        for joint, found in enumerate(drive_estimates(tree, recording, bodies, settings=SETTINGS)):
            assert found.joint == tree.names[joint]
            assert [term.law.kind for term in found.terms] == list(TERMS)
            values, sigma = numbers(found)
            scores.append((values - truths(tree, joint)) / sigma)
    assert np.abs(scores).max() < 4.5
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_exact_data_give_exact_constants(name: str) -> None:
    tree = driven(name)
    recording = reported(tree, ideal(tree))
    settings = replace(EXACT, terms=TERMS)
    bodies = tb.identify(tree, recording, settings=settings)
    for joint, found in enumerate(drive_estimates(tree, recording, bodies, settings=settings)):
        values, _ = numbers(found)
        np.testing.assert_allclose(values, truths(tree, joint), rtol=1e-6)


@pytest.mark.slow
def test_doubt_about_the_bodies_counts() -> None:
    """Ten times the covariance of the plate's estimate: where it leads, so does sigma."""
    tree = driven("puma")
    recording = reported(tree, measured(tree))
    bodies = tb.identify(tree, recording, settings=SETTINGS)
    doubted = replace(bodies, covariance=1e4 * bodies.covariance, sigma=100 * bodies.sigma)
    plain, more = (
        drive_estimates(tree, recording, each, settings=SETTINGS) for each in (bodies, doubted)
    )
    for a, b in zip(plain, more, strict=True):
        assert abs(a.constant - b.constant) < b.sigma  # more of it is taken for diluted
        assert b.sigma > 5 * a.sigma


@pytest.mark.slow
def test_another_recording_may_tell_the_bodies() -> None:
    tree = driven("ur5")
    bodies = tb.identify(tree, without(measured(tree, 1), "torque"), settings=SETTINGS)
    recording = reported(tree, without(measured(tree, 2), "wrench"))
    for joint, found in enumerate(drive_estimates(tree, recording, bodies, settings=SETTINGS)):
        assert abs(found.constant - constants(tree)[joint]) < 4.5 * found.sigma


@pytest.mark.slow
def test_what_does_not_belong_together_is_refused() -> None:
    tree = driven("puma")
    recording = measured(tree)
    bodies = tb.identify(tree, recording)
    inner = tb.identify(tree, recording, "internal")
    with pytest.raises(SettingsError, match="plate's estimate"):
        drive_estimates(tree, recording, inner)
    with pytest.raises(SettingsError, match="plate's estimate"):
        drive_estimates(tree, recording, bodies, settings=tb.Settings(zeros=True))
    with pytest.raises(RecordingError, match="no torque"):
        drive_estimates(tree, without(recording, "torque"), bodies)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_too_few_rows_of_a_joint_are_refused_by_its_name(name: str) -> None:
    tree = driven(name)
    bodies = tb.identify(tree, measured(tree))
    with pytest.raises(RecordingError, match=f"rows of joint '{tree.names[0]}' do not tell its"):
        drive_estimates(tree, measured(tree, 3, duration=0.85), bodies)


@pytest.mark.slow
def test_all_laws_can_be_asked_for() -> None:
    tree = driven("puma")
    recording = measured(tree)
    settings = tb.Settings(terms=[law.kind for law in LAWS])
    bodies = tb.identify(tree, recording, settings=settings)
    found = drive_estimates(tree, recording, bodies, settings=settings)
    assert all(len(each.terms) == len(LAWS) for each in found)


@pytest.mark.slow
def test_a_poorly_known_load_does_not_make_constants_small() -> None:
    """A plate of thirty times the usual noise: errors of the bodies take part of a constant.

    Put back, constants are as the combined estimate has them, which has no columns with errors.
    """
    tree, rng = driven("ur5"), np.random.default_rng(3)
    plain = reported(tree, measured(tree, 3))
    noise = rng.normal(size=(plain.samples, 6)) * np.repeat([15.0, 3.0], 3)
    recording = replace(plain, wrench=plain.measured("wrench") + noise)
    bodies = tb.identify(tree, recording)
    torques = torques_beside(tree, recording, bodies, tb.Settings().laws)
    found = regressions(torques, bodies)
    shares = np.array([each.reliability for each in found])
    assert shares.min() < 0.97
    both = combined(torques, bodies, found)
    for each, true, constant, sigma in zip(
        found, constants(tree), both.constants, both.constant_sigma, strict=True
    ):
        spread = float(np.sqrt(each.covariance[0, 0]))
        assert abs(each.values[0] - true) < 4 * spread
        assert abs(each.values[0] - constant) < 3 * np.hypot(spread, sigma)
        diluted = each.values[0] * each.reliability
        if each.reliability < 0.8:
            assert abs(diluted - true) > abs(each.values[0] - true)
