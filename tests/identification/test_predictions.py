"""Predictions are what identification has fitted: the same residuals, channel by channel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.identification.estimate import METHODS, SIGNAL_OF, Estimate, Method
from testbed.identification.filters import motion_taps, reversal_samples, row_weights
from testbed.identification.predict import (
    friction,
    motion_in,
    own_torque,
    parameters_of,
    predictions,
)
from testbed.recordings.recording import Recording
from testbed.robot.friction import LAWS
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.robots import random_robot

pytestmark = pytest.mark.slow

EVERY = tuple(law.kind for law in LAWS)
FILTERED = tb.Settings(position_cutoff=20.0, cutoff=5.0)
MOON = np.array([0.3, -0.2, -1.62])
SEEDS = (1, 3, 8, 12)


def robot(seed: int) -> tb.Tree:
    """A random tree on a pedestal, with friction and rotors."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 2 + seed % 4).tree()
    joints = [
        replace(j, coulomb=a, viscous=b, rotor_inertia=c)
        for j, (a, b, c) in zip(tree.joints, rng.uniform(0.5, 2, (tree.n, 3)), strict=True)
    ]
    return replace(tree, joints=tuple(joints))


def noisy(tree: tb.Tree, seed: int, **changes: Any) -> Recording:
    """Noise on plate and drives, the pedestal's weight on the plate, every motor off."""
    rng = np.random.default_rng(seed)
    clean = ideal(tree, duration=20.0, seed=seed)
    tare = tb.pedestal_wrench(tree)
    wrench = rng.normal(size=(clean.samples, 6)) + tare
    torque = rng.normal(size=(clean.samples, tree.n)) + np.linspace(-1, 1, tree.n)
    known = {"tare": tare} | changes
    return replace(plus(clean, wrench=wrench, torque=torque), **known)


def unexplained(
    tree: tb.Tree,
    recording: Recording,
    estimates: dict[Method, Estimate],
    settings: tb.Settings,
    gravity: Array | None = None,
) -> dict[Method, Array]:
    """Rms of what each method's prediction leaves of its own signal, at the estimator's rows."""
    motion, inner = motion_in(recording, settings)
    wrench, torque = predictions(tree, recording, motion, estimates, gravity)
    weights = row_weights(recording.rate, settings.row_low_pass)
    slow = settings.row_low_pass
    each = {"white": 4.0, "ar": 2.0}[settings.noise]  # rows a second and Hz of the filter
    step = 1 if slow is None else int((1 + 1e-9) * recording.rate / (each * slow))
    half = len(weights) // 2
    found: dict[Method, Array] = {}
    for method, estimate in estimates.items():
        predicted = (wrench if method == "external" else torque)[method]
        rest = recording.measured(SIGNAL_OF[method])[inner] - predicted
        rows = np.column_stack([np.convolve(r, weights, "valid") for r in rest.T])[::step]
        counts = np.ones(rows.shape, dtype=bool)
        if method == "internal":
            near = reversal_samples(weights, settings.reversal_reach, recording.rate)
            moves = np.abs(motion.qd) > settings.deadband
            counts = np.array(
                [
                    moves[k - near : k + near + 1].all(axis=0)
                    for k in range(half, len(motion.t) - half, step)
                ]
            )
        if estimate.noise is not None:  # about the mean where a channel has a constant
            mean = (rows * counts).sum(axis=0) / counts.sum(axis=0)
            rows = rows - np.where(estimate.noise.bias_sigma > 0, mean, 0.0)
        found[method] = np.sqrt((rows**2 * counts).sum(axis=0) / counts.sum(axis=0))
    return found


def agree(
    tree: tb.Tree,
    recording: Recording,
    settings: tb.Settings,
    methods: tuple[Method, ...] = METHODS,
    gravity: Array | None = None,
) -> None:
    """Predictions less measurements are the residuals of the estimates."""
    estimates = {
        m: tb.identify(tree, recording, m, settings=settings, gravity=gravity) for m in methods
    }
    found = unexplained(tree, recording, estimates, settings, gravity)
    for method, estimate in estimates.items():
        np.testing.assert_allclose(found[method], estimate.residual, rtol=1e-8)


@pytest.mark.parametrize("settings", [EXACT, FILTERED], ids=["exact", "filtered"])
@pytest.mark.parametrize("terms", [(), ("coulomb", "viscous"), ("viscous", "offset"), EVERY])
@pytest.mark.parametrize("seed", SEEDS)
def test_with_any_terms(seed: int, terms: tuple[str, ...], settings: tb.Settings) -> None:
    tree = robot(seed)
    agree(tree, noisy(tree, seed), replace(settings, terms=terms))


@pytest.mark.parametrize("seed", SEEDS)
def test_in_either_order(seed: int) -> None:
    """To the bit."""
    tree = robot(seed)
    recording = noisy(tree, seed)
    agree(tree, recording, EXACT, METHODS[::-1])
    estimates = {m: tb.identify(tree, recording, m, settings=EXACT) for m in METHODS}
    motion, _ = motion_in(recording)
    one = predictions(tree, recording, motion, estimates)
    other = predictions(tree, recording, motion, {m: estimates[m] for m in METHODS[::-1]})
    for ours, theirs in zip(one, other, strict=True):
        assert list(ours) == list(theirs) == list(METHODS)
        for method in METHODS:
            np.testing.assert_array_equal(ours[method], theirs[method])


@pytest.mark.parametrize("seed", SEEDS)
def test_without_noise_both_methods_predict_what_happened(seed: int) -> None:
    """The internal wrench takes from the external estimate what joint torques cannot tell."""
    tree = robot(seed)
    plain = replace(tree, joints=tuple(replace(j, rotor_inertia=0.0) for j in tree.joints))
    with_rotor = replace(EXACT, terms=("coulomb", "viscous", "rotor"))
    for robot_, settings in ((plain, EXACT), (tree, with_rotor)):
        recording = ideal(robot_, seed=seed)
        estimates = {m: tb.identify(robot_, recording, m, settings=settings) for m in METHODS}
        motion, _ = motion_in(recording)
        wrench, torque = predictions(robot_, recording, motion, estimates)
        felt, driven = recording.measured("wrench"), recording.measured("torque")
        own = own_torque(motion, estimates["internal"])
        assert np.abs(torque["internal"] - driven).max() <= 1e-8 * np.abs(driven).max()
        assert np.abs(wrench["external"] - felt).max() <= 1e-9 * np.abs(felt).max()
        if robot_ is plain:  # a rotor may hide in a body's inertia, which the plate would feel
            assert np.abs(wrench["internal"] - felt).max() <= 1e-8 * np.abs(felt).max()
            assert np.abs(torque["external"] + own - driven).max() <= 1e-8 * np.abs(driven).max()


@pytest.mark.parametrize("seed", SEEDS)
def test_under_the_recordings_gravity(seed: int) -> None:
    """Recorded on a leaning moon, predicted with a model file that says earth."""
    tree = robot(seed)
    there = noisy(tree.with_gravity(MOON), seed, facts={"gravity": MOON.tolist()})
    agree(tree, there, EXACT)
    silent = replace(there, facts={})
    agree(tree, silent, EXACT, gravity=MOON)
    agree(tree, replace(silent, tare=None), EXACT, gravity=MOON)
    lies = replace(there, facts={"gravity": [0.0, 0.0, -9.81]})
    agree(tree, lies, EXACT, gravity=MOON)


@pytest.mark.parametrize("seed", SEEDS)
def test_with_and_without_a_tare(seed: int) -> None:
    """The pedestal of the model stands in for a tare that the recording does not state."""
    tree = robot(seed)
    agree(tree, noisy(tree, seed, tare=None), EXACT)
    agree(tree, noisy(tree, seed, tare=np.zeros(6)), EXACT)


@pytest.mark.parametrize("seed", SEEDS)
def test_with_torques_or_a_wrench_alone(seed: int) -> None:
    tree = robot(seed)
    recording = noisy(tree, seed)
    plate, drives = replace(recording, torque=None), replace(recording, wrench=None)
    agree(tree, plate, EXACT, ("external",))
    agree(tree, drives, EXACT, ("internal",))
    for lacking, method in ((plate, "internal"), (drives, "external")):
        with pytest.raises(tb.TestbedError, match=f"has no {SIGNAL_OF[method]}"):  # type: ignore[index]
            tb.identify(tree, lacking, method, settings=EXACT)  # type: ignore[arg-type]
    internal = tb.identify(tree, drives, "internal", settings=EXACT)
    wrench, torque = predictions(tree, drives, motion_in(drives)[0], {"internal": internal})
    assert not wrench
    assert list(torque) == ["internal"]


@pytest.mark.parametrize("lost", [("velocity",), ("acceleration",), ("velocity", "acceleration")])
@pytest.mark.parametrize("seed", SEEDS)
def test_with_sensed_kinematics_in_part(seed: int, lost: tuple[str, ...]) -> None:
    """What is sensed in part only is had from the encoders altogether, here as there."""
    tree = robot(seed)
    recording = replace(noisy(tree, seed), **dict.fromkeys(lost))  # type: ignore[arg-type]
    agree(tree, recording, FILTERED)
    motion, inner = motion_in(recording, FILTERED)
    reach = motion_taps(recording.rate, FILTERED.position_low_pass).shape[1] // 2
    assert (inner.start, inner.stop) == (reach, recording.samples - reach)
    assert motion.samples == recording.samples - 2 * reach


def test_own_torques_are_the_sum_of_the_terms() -> None:
    tree = robot(3)
    recording = noisy(tree, 3)
    settings = replace(EXACT, terms=EVERY)
    found = tb.identify(tree, recording, "internal", settings=settings)
    motion, _ = motion_in(recording)
    expected = np.zeros_like(motion.qd)
    columns = {
        "coulomb": np.sign(motion.qd),
        "viscous": motion.qd,
        "offset": np.ones_like(motion.qd),
        "rotor": motion.qdd,
        "asymmetric": np.abs(motion.qd),
        "quadratic": motion.qd * np.abs(motion.qd),
        "square_root": np.sign(motion.qd) * np.sqrt(np.abs(motion.qd)),
    }
    for term in found.joint_terms:
        j = tree.names.index(term.joint)
        expected[:, j] += term.value * columns[term.kind][:, j]
    np.testing.assert_allclose(own_torque(motion, found), expected, rtol=1e-12, atol=1e-12)
    steady = friction(motion.qd, found)
    rotors = [t for t in found.joint_terms if t.kind == "rotor"]
    for term in rotors:
        j = tree.names.index(term.joint)
        expected[:, j] -= term.value * motion.qdd[:, j]
    np.testing.assert_allclose(steady, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_parameters_have_the_estimates_minimal_ones(method: Method) -> None:
    """And those of the others that are nearest."""
    tree = robot(8)
    estimate = tb.identify(tree, noisy(tree, 8), method, settings=EXACT)
    others = np.random.default_rng(0).normal(size=(tree.n, 10))
    for near in (None, others):
        theta = parameters_of(estimate, near)
        assert theta.shape == (tree.n, 10)
        scale = np.abs(estimate.base.values).max()
        gap = estimate.base.matrix @ theta.ravel() - estimate.base.values
        assert np.abs(gap).max() <= 1e-10 * scale
    null = np.eye(10 * tree.n) - np.linalg.pinv(estimate.base.matrix) @ estimate.base.matrix
    kept = null @ (parameters_of(estimate, others) - others).ravel()
    assert np.abs(kept).max() <= 1e-9
