"""Predictions, which people plot beside what was measured, are what identification has fitted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.errors import RecordingError
from testbed.identification.estimate import METHODS, Method
from testbed.identification.predict import (
    friction,
    motion_in,
    own_torque,
    predictions,
)
from testbed.identification.validate import validate
from testbed.robot.friction import LAWS
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.runs import noisy, without
from tests.helpers.strategies import few, rngs
from tests.identification.test_validation import witness

FILTERED = tb.Settings(position_cutoff=20.0, cutoff=5.0, deadband=0.05)
EVERY = tuple(law.kind for law in LAWS)
MOON = np.array([0.3, -0.2, -1.62])
CASES: tuple[dict[str, Any], ...] = (
    {},
    {"tare": None},
    {"tare": np.zeros(6)},
    {"velocity": None},
    {"acceleration": None},
    {"velocity": None, "acceleration": None},
    {"facts": {"gravity": MOON.tolist()}},
)


@few(10)
@given(rngs, st.sampled_from(CASES), st.sampled_from([EXACT, FILTERED]))
def test_what_a_prediction_leaves_is_the_estimates_residual(
    rng: np.random.Generator, case: dict[str, Any], treated: tb.Settings
) -> None:
    """Whatever was sensed, tared and under whose gravity; in either order to the bit."""
    tree = random_robot(rng, int(rng.integers(2, 6))).tree()
    there = tree.with_gravity(MOON) if "facts" in case else tree
    recording = replace(noisy(ideal(there, duration=20.0)), **case)
    treated = replace(treated, terms=EVERY[: int(rng.integers(8))], noise="white")
    estimates = {m: tb.identify(tree, recording, m, settings=treated) for m in METHODS}
    for estimate in estimates.values():
        _, rms, _ = witness(tree, recording, estimate, treated)
        np.testing.assert_allclose(rms, estimate.residual, rtol=1e-8)
        again = validate(tree, recording, estimate, settings=treated)
        np.testing.assert_allclose(again.residual, estimate.residual, rtol=1e-7)


@few(5)
@given(rngs)
def test_without_noise_both_methods_foretell_what_happened(rng: np.random.Generator) -> None:
    """In either order; the internal wrench takes from the plate what joint torques cannot tell."""
    tree = random_robot(rng, int(rng.integers(2, 6))).tree()
    tree = tree.with_joints({name: {"coulomb": 2.0, "viscous": 1.0} for name in tree.names})
    recording = ideal(tree)
    estimates = {m: tb.identify(tree, recording, m, settings=EXACT) for m in METHODS[::-1]}
    motion, where = motion_in(recording)
    assert where == slice(0, recording.samples)
    wrench, torque = predictions(tree, recording, motion, estimates)
    own = own_torque(motion, estimates["internal"])
    felt, driven = recording.measured("wrench"), recording.measured("torque")
    for found, wanted in (
        (torque["internal"], driven),
        (torque["external"] + own, driven),
        (wrench["internal"], felt),
        (wrench["external"], felt),
    ):
        assert np.abs(found - wanted).max() <= 1e-8 * np.abs(wanted).max()
    expected = 2.0 * np.sign(motion.qd) + motion.qd
    np.testing.assert_allclose(friction(motion.qd, estimates["internal"]), expected, atol=1e-7)


def test_an_instrument_that_lacks_a_signal_is_foretold_by_the_other(puma: tb.Tree) -> None:
    cases: tuple[tuple[str, Method, Method], ...] = (
        ("torque", "external", "internal"),
        ("wrench", "internal", "external"),
    )
    for signal, one, other in cases:
        lacking = without(noisy(ideal(puma)), signal)
        estimate = tb.identify(puma, lacking, one, settings=EXACT)
        with refuses(RecordingError, signal):
            tb.identify(puma, lacking, other, settings=EXACT)
        wrench, torque = predictions(puma, lacking, motion_in(lacking)[0], {one: estimate})
        assert list(torque) == [one]
        assert list(wrench) == ([one] if one == "external" else [])


def test_the_motion_from_encoders_is_the_motion_within_its_ends(puma: tb.Tree) -> None:
    """What is slow passes: values and derivatives are those of the motion, at their instants."""
    recording = ideal(puma, duration=20.0)
    encoders = replace(recording, velocity=None, acceleration=None)
    motion, where = motion_in(encoders, tb.Settings(position_cutoff=40.0, cutoff=5.0))
    assert 0 < where.start == recording.samples - where.stop < recording.samples // 10
    np.testing.assert_array_equal(motion.t, recording.time[where])
    for found, signal, error in (
        (motion.q, "position", 1e-6),
        (motion.qd, "velocity", 1e-5),
        (motion.qdd, "acceleration", 1e-4),
    ):
        np.testing.assert_allclose(found, recording.measured(signal)[where], atol=error)
    assert motion_in(encoders.part(0, 2 * where.start + 1))[0].samples == 1
    with refuses(RecordingError):
        motion_in(encoders.part(0, 2 * where.start))
