"""Predictions are what was fitted; on another recording they err as noise and sigma allow.

If one fails, a wrong model passes on a new motion, or a right one is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.applications.prediction import longest_segment_motion, predicted_signals
from testbed.applications.validate import MAX_ERROR_RATIO, validate
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, SettingsError, UnknownName
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.windows import ROWS_PER_CUTOFF, row_weights
from testbed.core.estimation.sensor.estimates import NuisanceEstimate
from testbed.core.kernel.records import REST_VARIANCE
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.metadata import Metadata, vector_tuple
from testbed.core.robot.friction import JOINT_LAWS
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.measured import measured
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.runs import noisy, robot, without
from tests.helpers.strategies import Rng, few, rngs

SETTINGS = tb.Settings(deadband=0.05)


def witness(
    tree: tb.Tree, recording: tb.Recording, estimate: Estimate, settings: tb.Settings
) -> tuple[Array, Array, Array]:
    """Rows, rms and mean of residuals by dense inverse dynamics and a filter by NumPy."""
    settings = settings.fitted(recording.rate)
    motion, inner = longest_segment_motion(recording, settings)
    wrench, torque = predicted_signals(tree, recording, motion, {estimate.method: estimate})
    foretold = (wrench if estimate.method == "wrench" else torque)[estimate.method]
    left = recording.measured(estimate.method)[inner] - foretold
    weights = row_weights(recording.rate, settings.row_low_pass)
    passed = np.column_stack([np.convolve(each, weights, "valid") for each in left.T])
    cutoff, step = settings.row_low_pass, 1
    if cutoff is not None:
        step = int((1 + 1e-9) * recording.rate / (ROWS_PER_CUTOFF * cutoff))
    at = np.arange(0, len(passed), step)
    counts, used = np.ones((len(at), left.shape[1]), dtype=bool), passed[at]
    size = Problem.from_recording(tree, recording, estimate.method, settings).layout.rows.block
    for joint in range(left.shape[1] if estimate.method == "torque" else 0):
        rests = np.abs(motion.qd[:, joint]) <= settings.deadband
        at_rest = [(weights * rests[first : first + len(weights)]).any() for first in at]
        near = np.flatnonzero(at_rest)
        of_samples = np.zeros((len(near), len(rests)))
        for row, first in zip(of_samples, at[near], strict=True):
            part = slice(first, first + len(weights))
            row[part] = weights * rests[part]
        together = near // size == near[:, None] // size  # block by block
        shared = of_samples @ of_samples.T / (weights @ weights) * together
        root = np.linalg.cholesky(np.eye(len(near)) + REST_VARIANCE * shared)
        counts[near, joint] = (shared.diagonal() < 0.5) & (root.diagonal() ** 2 < 11)
        used[near, joint] = np.linalg.solve(root, used[near, joint])
    rows, used = counts.sum(axis=0), used * counts
    return rows, np.sqrt((used**2).sum(axis=0) / rows), used.sum(axis=0) / rows


@pytest.mark.parametrize("method", SIGNALS)
@pytest.mark.parametrize("name", ["puma", "random"])
def test_residuals_and_spread_are_those_of_dense_computation(name: str, method: Signal) -> None:
    """Inverse dynamics row by row; the spread of predictions, direction by direction.

    Neither the model file's masses nor the truth are looked at.
    """
    tree = robot(name)
    estimate = tb.identify(tree, measured(tree, 1, duration=12), method, settings=SETTINGS)
    other = measured(tree, 2, duration=9)
    heavier, lie = replace(tree, inertias=tree.inertias[::-1]), ideal(tree, 9).truth
    found = validate(heavier, replace(other, truth=lie), estimate, settings=SETTINGS)
    rows, rms, mean = witness(tree, other, estimate, SETTINGS)
    assert found.rows == tuple(rows)
    np.testing.assert_allclose(found.residual, rms, rtol=1e-9)
    np.testing.assert_allclose(found.mean, mean, rtol=1e-9, atol=1e-9 * rms.max())
    silent = plus(other, wrench=-other.measured("wrench"), torque=-other.measured("torque"))
    silent = replace(silent, tare=np.zeros(6))
    squares = np.zeros(len(found.channels))
    sizes, ways = np.linalg.eigh(estimate.covariance)
    for size, way in zip(sizes, ways.T, strict=True):
        one = replace(estimate, values=way)
        squares += size * validate(tree, silent, one, settings=SETTINGS).residual ** 2
    np.testing.assert_allclose(found.spread, np.sqrt(squares), rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("method", SIGNALS)
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_sound_instruments_are_foretold_and_changed_gains_named(name: str, method: Signal) -> None:
    """Another motion as sigma says; five per cent in any channel that is strong enough."""
    tree, signal = robot(name), method
    estimate, other = tb.identify(tree, measured(tree, 1), method), measured(tree, 2)
    found = validate(tree, other, estimate)
    assert np.all((found.ratio > 0.6) & (found.ratio < 1.6))
    assert found.diagnostics == ()
    strong = np.flatnonzero(0.05 * found.signal > 3 * MAX_ERROR_RATIO * estimate.residual)
    assert len(strong) > 0
    for c in strong.tolist():
        more = 0.05 * np.eye(len(found.signal))[c] * other.measured(signal)
        (told,) = validate(tree, plus(other, **{signal: more}), estimate).diagnostics
        assert (told.code.partition("-")[0], told.subject) == (
            "estimate.prediction",
            estimate.label(c),
        )


def test_a_joint_that_rests_all_the_time_has_no_residual(puma: tb.Tree) -> None:
    settings = replace(EXACT, deadband=0.3)
    estimate = tb.identify(puma, noisy(ideal(puma, seed=1)), "torque", settings=settings)
    other = noisy(ideal(puma, seed=2))
    still = replace(other, velocity=other.measured("velocity") * [1.0, 0.0, 1.0])
    found = validate(puma, still, estimate, settings=settings)
    assert found.rows[1] == 0
    assert np.isnan([found.residual[1], found.ratio[1], found.signal[1], found.spread[1]]).all()
    assert not any("shoulder" in each.subject for each in found.diagnostics)


@pytest.mark.slow
def coefficients(values: Mapping[str, float]) -> tuple[NuisanceEstimate, ...]:
    return tuple(NuisanceEstimate("", name, "", value, 0.0) for name, value in values.items())


def test_lasting_faults_are_taken_back_and_passing_ones_are_told(puma: tb.Tree) -> None:
    """A late plate and encoders' zeros last; the plate's zero is another each time."""
    one, other = (measured(puma, seed) for seed in (1, 2))
    sound = tb.identify(puma, one)
    plain, zero = validate(puma, other, sound), np.array([0.0, -8.0, 0, 0, 0, 0])
    found = validate(puma, plus(other, wrench=zero), sound)
    gain = validate(puma, plus(other, wrench=0.05 * other.measured("wrench")), sound)
    assert [each.subject for each in found.diagnostics] == ["channel Fy"]
    assert found.diagnostics[0].code not in [each.code for each in gain.diagnostics]
    np.testing.assert_allclose(found.mean, zero, atol=1.0)
    off = np.array([0.0, 0.03, -0.05])
    zeros = {f"joint_zeros/{j}": float(x) for j, x in zip(puma.names, off, strict=True)}
    moved = plus(other, position=off)
    backwards = {s: moved.measured(s)[:, ::-1] for s in ("position", "torque")}
    shuffled = replace(moved, names=puma.names[::-1], **backwards)  # type: ignore[arg-type]
    passing = {"bias/Fx": 50.0, "slope/Fy": 5.0}
    for recording, numbers, error in ((other, passing, 0.0), (shuffled, zeros, 1e-6)):
        again = validate(puma, recording, replace(sound, nuisances=coefficients(numbers)))
        np.testing.assert_allclose(again.residual, plain.residual, rtol=error)
    asked = tb.Settings(nuisances=("skew",))
    late = [replace(r.part(4, r.samples), wrench=r.measured("wrench")[:-4]) for r in (one, other)]
    estimate = tb.identify(puma, late[0], settings=asked)
    assert estimate.nuisances[0].value == pytest.approx(0.02, rel=0.1)
    ignorant = replace(estimate, nuisances=())
    told, silent = (validate(puma, late[1], e, settings=asked) for e in (ignorant, estimate))
    assert told.diagnostics
    assert not silent.diagnostics


def test_what_does_not_fit_together_is_refused(puma: tb.Tree) -> None:
    estimate, other = tb.identify(puma, ideal(puma), settings=EXACT), ideal(puma, seed=2)
    five: dict[str, Any] = dict.fromkeys(("residual", "relative_residual"), np.ones(5))
    narrow = replace(estimate, channels=("",) * 5, **five)
    elsewhere = replace(estimate, nuisances=coefficients({"pose/rw": 1.0}))
    tilted = replace(other, metadata=Metadata(gravity=(9.81, 0.0, 0.0)))
    for kind, culprit, recording, said_so, settings in (
        (SettingsError, "K3xy", other, estimate, replace(EXACT, zeros=True)),
        (RecordingError, "wrench", without(other, "wrench"), estimate, EXACT),
        (RecordingError, "robot", ideal(robot("ur5")), estimate, EXACT),
        (SettingsError, "gravity", tilted, estimate, EXACT),
        (SettingsError, "5 channels", other, narrow, EXACT),
    ):
        with refuses(kind, culprit):
            validate(puma, recording, said_so, settings=settings)
    with refuses(UnknownName, "pose/rw"):
        validate(puma, other, elsewhere, settings=EXACT)


FILTERED = tb.Settings(position_cutoff=20.0, cutoff=5.0, deadband=0.05)
EVERY = tuple(law.kind for law in JOINT_LAWS)
MOON = np.array([0.3, -0.2, -1.62])
CASES: tuple[dict[str, Any], ...] = (
    {},
    {"tare": None},
    {"tare": np.zeros(6)},
    {"velocity": None},
    {"acceleration": None},
    {"velocity": None, "acceleration": None},
    {"metadata": Metadata(gravity=vector_tuple(MOON))},
)


@pytest.mark.parametrize("case", CASES)
@few(2)
@given(rngs, st.sampled_from([EXACT, FILTERED]))
def test_predictions_leave_residuals(case: dict[str, Any], rng: Rng, treated: tb.Settings) -> None:
    """Whatever was sensed, tared and under whose gravity; about the mean beside a constant."""
    tree = random_robot(rng, int(rng.integers(2, 6))).tree()
    there = tree.with_gravity(MOON) if "metadata" in case else tree
    recording = replace(noisy(ideal(there, duration=20.0)), **case)
    treated = replace(treated, terms=EVERY[: int(rng.integers(8))])
    for method in SIGNALS:
        estimate = tb.identify(tree, recording, method, settings=treated)
        found = validate(tree, recording, estimate, settings=treated)
        assert estimate.noise is not None
        left = np.where(estimate.noise.bias != 0, found.scatter, found.residual)
        np.testing.assert_allclose(left, estimate.residual, rtol=1e-7)


def test_the_motion_from_encoders_is_the_motion_within_its_ends(puma: tb.Tree) -> None:
    """What is slow passes: values and derivatives are those of the motion, at their instants."""
    recording = ideal(puma, duration=20.0)
    encoders = replace(recording, velocity=None, acceleration=None)
    motion, where = longest_segment_motion(encoders, tb.Settings(position_cutoff=40.0, cutoff=5.0))
    assert 0 < where.start == recording.samples - where.stop < recording.samples // 10
    np.testing.assert_array_equal(motion.t, recording.time[where])
    for found, signal, error in (
        (motion.q, "position", 1e-6),
        (motion.qd, "velocity", 1e-5),
        (motion.qdd, "acceleration", 1e-4),
    ):
        np.testing.assert_allclose(found, recording.measured(signal)[where], atol=error)
    assert longest_segment_motion(encoders.part(0, 2 * where.start + 1))[0].samples == 1
    with refuses(RecordingError):
        longest_segment_motion(encoders.part(0, 2 * where.start))
