"""Drives held against the plate: torque constants, rotors, friction over velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import RecordingError, SettingsError
from testbed.identification.combined import combined
from testbed.identification.drive_findings import DriveFindings, identify_drives
from testbed.identification.drive_regression import regressions, torques_beside
from testbed.identification.estimate import METHODS
from testbed.identification.friction_curves import friction_curves
from testbed.recordings.recording import Recording
from testbed.robot.friction import stribeck
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.measured import measured
from tests.helpers.refusals import refuses
from tests.helpers.runs import robot, without

TERMS = ("coulomb", "viscous", "rotor")
SETTINGS = tb.Settings(terms=TERMS)


def driven(name: str, rotor: float = 0.1) -> tb.Tree:
    """A robot with friction and rotors at every joint."""
    joints = {
        n: {"coulomb": 3.0 + k, "viscous": 2.0 + k, "rotor_inertia": rotor * (1 + k)}
        for k, n in enumerate(robot(name).names)
    }
    return robot(name).with_joints(joints)


def constants(tree: tb.Tree) -> Array:
    """Up to 8 % off."""
    return np.asarray(1 + 0.08 * np.sin(1.0 + np.arange(tree.n)))


def reported(tree: tb.Tree, recording: Recording) -> Recording:
    """By drives with such constants."""
    return replace(recording, torque=recording.measured("torque") * constants(tree))


def findings(tree: tb.Tree, recording: Recording, how: tb.Settings) -> DriveFindings:
    """Beside the plate's estimate from the same recording."""
    bodies = tb.identify(tree, recording, settings=how)
    return identify_drives(tree, recording, bodies, settings=how)


def errors(tree: tb.Tree, found: DriveFindings) -> tuple[Array, Array]:
    """Of constants, friction and rotors, joint by joint; and their sigmas, (n, 4)."""
    told, sigma = [], []
    for drive, joint, constant in zip(found.estimates, tree.joints, constants(tree), strict=True):
        assert (drive.joint, [term.law.kind for term in drive.terms]) == (joint.name, list(TERMS))
        true = [constant, joint.coulomb, joint.viscous, joint.rotor_inertia]
        told.append(np.array([drive.constant, *(term.value for term in drive.terms)]) - true)
        sigma.append([drive.sigma, *(term.sigma for term in drive.terms)])
    return np.array(told), np.array(sigma)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_constants_friction_and_rotors_are_found(name: str) -> None:
    """Exactly of exact data, within sigmas of noisy ones; together no worse than the plate."""
    tree = driven(name)
    exact = findings(tree, reported(tree, ideal(tree)), replace(EXACT, terms=TERMS))
    assert np.abs(errors(tree, exact)[0]).max() < 1e-5
    recording = reported(tree, measured(tree, 1, duration=30.0))
    bodies = tb.identify(tree, recording, settings=SETTINGS)
    found = identify_drives(tree, recording, bodies, settings=SETTINGS)
    gaps, sigma = errors(tree, found)
    assert np.abs(gaps / sigma).max() < 4.5
    assert 0.5 < np.sqrt(np.mean((gaps / sigma) ** 2)) < 1.6
    both = found.combined
    assert (both.sigma <= bodies.sigma * (1 + 1e-9)).all()
    truth = bodies.minimal.values(tb.barycentric(tree))
    assert np.abs((both.values - truth) / both.sigma).max() < 5
    assert np.abs((both.constants - constants(tree)) / both.constant_sigma).max() < 4.5
    assert both.disagreement.chance > 0.003
    assert both.disagreement.warnings == ()


@pytest.mark.slow
def test_a_poorly_known_load_does_not_make_constants_small() -> None:
    """A plate of thirty times the usual noise: errors of the bodies take part of a constant.

    Put back, constants are as the combined estimate has them, which has no columns with errors.
    """
    tree, rng = driven("ur5"), np.random.default_rng(3)
    plain = reported(tree, measured(tree, 3))
    noise = rng.normal(size=(plain.samples, 6)) * np.repeat([15.0, 3.0], 3)
    recording = plus(plain, wrench=noise)
    bodies = tb.identify(tree, recording)
    torques = torques_beside(tree, recording, bodies, tb.Settings().laws)
    found = regressions(torques, bodies)
    both = combined(torques, bodies, found)
    assert min(each.reliability for each in found) < 0.97
    told = zip(found, constants(tree), both.constants, both.constant_sigma, strict=True)
    for each, true, constant, sigma in told:
        spread = float(np.sqrt(each.covariance[0, 0]))
        assert abs(each.values[0] - true) < 4 * spread
        assert abs(each.values[0] - constant) < 3 * np.hypot(spread, sigma)
        diluted = each.values[0] * each.reliability
        assert each.reliability > 0.8 or abs(diluted - true) > abs(each.values[0] - true)
    shared = [bodies.names.index(name) for name in both.disagreement.names]
    assert np.median(both.sigma[shared] / bodies.sigma[shared]) < 0.8


@pytest.mark.slow
def test_a_rotor_that_is_not_among_the_terms_is_caught() -> None:
    """The plate does not feel it, the torques do: the two then differ in the bodies."""
    tree = driven("puma", 0.5)
    recording = measured(tree)
    missing, cured = (
        findings(robot("puma"), recording, each).combined.disagreement
        for each in (tb.Settings(), SETTINGS)
    )
    assert missing.chance < 1e-6
    assert missing.warnings
    assert cured.chance > 1e-3


@pytest.mark.slow
def test_friction_over_velocity_is_the_law_at_every_node() -> None:
    """Straight between nodes, the curve is exact at any scale; noisy ones hold to their sigmas."""
    tree = driven("puma", 0.0)
    exact = findings(tree, reported(tree, ideal(tree, 20.0)), EXACT).curves
    noisy = findings(tree, measured(tree, 1, duration=30.0), tb.Settings()).curves
    scores = []
    for joint, constant, curve, rough in zip(
        tree.joints, constants(tree), exact, noisy, strict=True
    ):
        assert curve.constant == pytest.approx(constant, rel=1e-6)
        assert len(curve.speed) > 6
        assert (np.diff(curve.speed) >= 0).all()
        for each, most in ((curve, 1e-5), (rough, 0.5)):
            moving = np.abs(each.speed) > 0.02
            speed = each.speed[moving]
            off = each.torque[moving] - joint.coulomb * np.sign(speed) - joint.viscous * speed
            assert np.abs(off).max() < most
        scores.append(off / each.sigma[moving])
    every = np.concatenate(scores)
    assert np.abs(every).max() < 5
    assert 0.5 < np.sqrt(np.mean(every**2)) < 1.6
    bodies = tb.identify(tree, measured(tree))
    for curve in friction_curves(tree, measured(tree, 3, duration=2.0), bodies):
        assert len(curve.speed) == 0
        assert not curve.at(np.linspace(-1, 1, 5)).any()


@pytest.mark.slow
def test_the_speed_at_which_friction_fades_is_found() -> None:
    """By an outer loop of the internal estimate, for all joints alike."""
    tree = driven("puma", 0.0)
    recording = ideal(tree, 20.0, own={stribeck(0.2): np.full(tree.n, 2.0)})
    how = replace(EXACT, terms=("coulomb", "viscous", "stribeck"))
    found = tb.identify(tree, recording, "internal", settings=how)
    named = [name for name in found.names if name.startswith("stribeck@")]
    assert len(named) == tree.n
    speed = float(named[0].partition("@")[2].partition("/")[0])
    assert speed == pytest.approx(0.2, rel=0.1)
    truth = tb.minimal_set(tree, "dynamic").values(tb.barycentric(tree))
    np.testing.assert_allclose(found.base.values, truth, rtol=2e-2, atol=2e-2)


@pytest.mark.slow
def test_what_tells_no_drives_is_refused() -> None:
    """Another method, no torques, too few rows."""
    tree = driven("puma")
    recording = measured(tree, duration=4.0)
    bodies, others = (tb.identify(tree, recording, method) for method in METHODS)
    for kind, culprit, given, by in (
        (SettingsError, "plate", recording, others),
        (RecordingError, "torque", without(recording, "torque"), bodies),
        (RecordingError, f"'{tree.names[0]}'", measured(tree, 3, duration=0.85), bodies),
    ):
        with refuses(kind, culprit):
            identify_drives(tree, given, by)
