"""An estimate against another recording: residuals in units of what noise and sigma allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import RecordingError, SettingsError, UnknownName
from testbed.identification.estimate import METHODS, Estimate, Method
from testbed.identification.filters import reversal_samples, row_weights
from testbed.identification.predict import motion_in, predictions
from testbed.identification.stated import stated
from testbed.identification.validate import LIMIT, validate
from testbed.identification.windows import ROWS_PER_CUTOFF
from testbed.recordings.recording import Recording
from tests.helpers.cases import cases
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.measured import measured
from tests.helpers.robots import random_robot
from tests.helpers.runs import ROBOTS, noisy, robot, without

SETTINGS = tb.Settings(deadband=0.05)


def witness(
    tree: tb.Tree, recording: Recording, estimate: Estimate, settings: tb.Settings
) -> tuple[Array, Array, Array]:
    """Rows, rms and mean of residuals by dense inverse dynamics and a filter by NumPy."""
    motion, inner = motion_in(recording, settings)
    wrench, torque = predictions(tree, recording, motion, {estimate.method: estimate})
    if estimate.method == "external":
        left = recording.measured("wrench")[inner] - wrench["external"]
    else:
        left = recording.measured("torque")[inner] - torque["internal"]
    weights = row_weights(recording.rate, settings.row_low_pass)
    passed = np.column_stack([np.convolve(each, weights, "valid") for each in left.T])
    cutoff, step = settings.row_low_pass, 1
    if cutoff is not None:
        step = int((1 + 1e-9) * recording.rate / (ROWS_PER_CUTOFF[settings.noise] * cutoff))
    at = np.arange(0, len(passed), step)
    counts = np.ones((len(at), left.shape[1]), dtype=bool)
    if estimate.method == "internal":
        half = len(weights) // 2
        reach = reversal_samples(weights, settings.reversal_reach, recording.rate)
        for k, first in enumerate(at):
            near = motion.qd[first + half - reach : first + half + reach + 1]
            counts[k] = (np.abs(near) > settings.deadband).all(axis=0)
    rows, used = counts.sum(axis=0), passed[at] * counts
    return rows, np.sqrt((used**2).sum(axis=0) / rows), used.sum(axis=0) / rows


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", cases(["puma", 1, 2, 3], fast=2))
def test_residuals_are_those_of_dense_inverse_dynamics(name: str | int, method: Method) -> None:
    tree = robot("puma")
    if isinstance(name, int):
        tree = random_robot(np.random.default_rng(name), 3 + name).tree()
    estimate = tb.identify(tree, measured(tree, 1, duration=12), method, settings=SETTINGS)
    other = measured(tree, 2, duration=9)
    found = validate(tree, other, estimate, settings=SETTINGS)
    rows, rms, mean = witness(tree, other, estimate, SETTINGS)
    assert found.rows == tuple(rows)
    np.testing.assert_allclose(found.residual, rms, rtol=1e-9)
    np.testing.assert_allclose(found.mean, mean, rtol=1e-9, atol=1e-9 * rms.max())
    assert found.channels == estimate.channels
    assert found.units == estimate.channel_units


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_what_sigma_adds_is_the_spread_of_predictions(puma: tb.Tree, method: Method) -> None:
    estimate = tb.identify(puma, measured(puma, 1, duration=12), method)
    still = replace(stated(estimate), values=np.zeros(len(estimate.names)))
    other = measured(puma, 2, duration=9)
    found = validate(puma, other, still)
    values, vectors = np.linalg.eigh(estimate.covariance)
    squares = np.zeros(len(found.channels))
    silent = plus(other, wrench=-other.measured("wrench"), torque=-other.measured("torque"))
    silent = replace(silent, tare=np.zeros(6))
    for size, direction in zip(values, vectors.T, strict=True):
        squares += size * validate(puma, silent, replace(still, values=direction)).residual ** 2
    np.testing.assert_allclose(found.spread, np.sqrt(squares), rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", cases(ROBOTS, fast=2))
def test_another_motion_of_a_sound_instrument_is_foretold_as_sigma_says(
    name: str, method: Method
) -> None:
    tree = robot(name)
    estimate = tb.identify(tree, measured(tree, 1), method)
    found = validate(tree, measured(tree, 2), estimate)
    assert np.all((found.ratio > 0.6) & (found.ratio < 1.6))
    assert found.warnings == ()


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", cases(ROBOTS, fast=1))
def test_a_gain_that_has_changed_is_noticed_and_named(name: str, method: Method) -> None:
    tree = robot(name)
    estimate = tb.identify(tree, measured(tree, 1), method)
    other, tried = measured(tree, 2), 0
    for c, size in enumerate(validate(tree, other, estimate).signal):
        if 0.05 * size < 3 * LIMIT * estimate.residual[c]:
            continue  # too faint for five per cent to show
        tried += 1
        gains = np.ones(len(estimate.channels))
        gains[c] = 1.05
        signal = "wrench" if method == "external" else "torque"
        wrong = plus(other, **{signal: other.measured(signal) * (gains - 1)})
        found = validate(tree, wrong, estimate)
        assert [f.subject for f in found.findings] == [estimate.label(c)]
        assert estimate.label(c) in found.warnings[0]
    assert tried > 0


def test_rows_in_the_deadband_do_not_count(puma: tb.Tree) -> None:
    settings = replace(EXACT, deadband=0.3)
    estimate = tb.identify(puma, noisy(ideal(puma, seed=1)), "internal", settings=settings)
    other = noisy(ideal(puma, seed=2))
    speed = other.velocity
    assert speed is not None
    rest = np.abs(speed) <= settings.deadband
    spoiled = plus(other, torque=1e6 * rest)
    found, same = (validate(puma, r, estimate, settings=settings) for r in (spoiled, other))
    np.testing.assert_array_equal(found.residual, same.residual)
    np.testing.assert_array_equal(found.spread, same.spread)
    assert found.rows == tuple((~rest).sum(axis=0))


def test_a_joint_that_rests_has_no_numbers_and_no_warning(puma: tb.Tree) -> None:
    estimate = tb.identify(puma, measured(puma, 1), "internal")
    other = measured(puma, 2)
    position = other.position.copy()
    position[:, 1] = 0.3
    found = validate(puma, replace(other, position=position), estimate)
    assert found.rows[1] == 0
    assert np.isnan([found.residual[1], found.ratio[1], found.signal[1], found.spread[1]]).all()
    assert not any("shoulder" in line for line in found.warnings)


@pytest.mark.slow
def test_another_zero_of_the_plate_is_told_from_another_gain(puma: tb.Tree) -> None:
    estimate = tb.identify(puma, measured(puma, 1))
    zero = np.array([0.0, -8.0, 0, 0, 0, 0])
    found = validate(puma, plus(measured(puma, 2), wrench=zero), estimate)
    assert [f.subject for f in found.findings] == ["channel Fy"]
    assert "another" in found.findings[0].causes[0]
    assert "zero" in found.findings[0].causes[0]
    np.testing.assert_allclose(found.mean, zero, atol=1.0)


@pytest.mark.slow
def test_numbers_of_the_instrument_are_taken_back_first(puma: tb.Tree) -> None:
    asked = tb.Settings(nuisances=("skew",))
    one, other = (late(measured(puma, seed), 4) for seed in (1, 2))
    estimate = tb.identify(puma, one, settings=asked)
    assert estimate.nuisances[0].value == pytest.approx(0.02, rel=0.1)
    assert validate(puma, other, estimate, settings=asked).warnings == ()
    ignorant = replace(stated(estimate), nuisances={})
    assert validate(puma, other, ignorant, settings=asked).warnings != ()


def late(recording: Recording, samples: int) -> Recording:
    """As a plate shows it that is late by whole samples."""
    wrench = np.roll(recording.measured("wrench"), samples, axis=0)
    return replace(recording, wrench=wrench).part(samples, recording.samples)


@pytest.mark.slow
def test_the_zero_of_one_recording_is_not_taken_for_that_of_another(puma: tb.Tree) -> None:
    estimate = tb.identify(puma, measured(puma, 1))
    said = replace(stated(estimate), nuisances={"bias/Fx": 50.0, "slope/Fy": 5.0})
    other = measured(puma, 2)
    np.testing.assert_array_equal(
        validate(puma, other, said).residual, validate(puma, other, estimate).residual
    )


@pytest.mark.slow
def test_zeros_of_encoders_are_taken_back_by_the_joints_names(puma: tb.Tree) -> None:
    estimate = stated(tb.identify(puma, measured(puma, 1)))
    off = np.array([0.0, 0.03, -0.05])
    zeros = {f"joint_zeros/{j}": float(x) for j, x in zip(puma.names, off, strict=True)}
    other = measured(puma, 2)
    moved = replace(other, position=other.position + off)
    order = [2, 0, 1]
    shuffled = replace(
        moved,
        names=tuple(puma.names[k] for k in order),
        position=moved.position[:, order],
        torque=moved.measured("torque")[:, order],
    )
    said = replace(estimate, nuisances=zeros)
    for recording in (moved, shuffled):
        np.testing.assert_allclose(
            validate(puma, recording, said).residual,
            validate(puma, other, estimate).residual,
            rtol=1e-6,
        )


@pytest.mark.parametrize("method", METHODS)
def test_masses_and_truth_are_not_looked_at(puma: tb.Tree, method: Method) -> None:
    estimate = tb.identify(puma, ideal(puma, seed=1), method, settings=EXACT)
    other = ideal(puma, seed=2)
    plain = validate(puma, other, estimate, settings=EXACT)
    heavier = replace(puma, inertias=puma.inertias[::-1])
    blind = validate(heavier, replace(other, truth=None), estimate, settings=EXACT)
    np.testing.assert_array_equal(plain.residual, blind.residual)
    np.testing.assert_array_equal(plain.ratio, blind.ratio)


def test_what_does_not_fit_together_is_refused(puma: tb.Tree) -> None:
    estimate = tb.identify(puma, ideal(puma), settings=EXACT)
    other = ideal(puma, seed=2)
    with pytest.raises(SettingsError, match="it lacks|not among them"):
        validate(puma, other, estimate, settings=replace(EXACT, zeros=True))
    with pytest.raises(RecordingError, match="no wrench"):
        validate(puma, without(other, "wrench"), estimate, settings=EXACT)
    with pytest.raises(RecordingError, match="another robot"):
        validate(puma, ideal(robot("ur5")), estimate, settings=EXACT)
    tilted = replace(other, facts={"gravity": [9.81, 0.0, 0.0]})
    with pytest.raises(SettingsError, match="gravity"):
        validate(puma, tilted, estimate, settings=EXACT)
    unknown = replace(stated(estimate), nuisances={"pose/rw": 1.0})
    with pytest.raises(UnknownName, match="nuisance"):
        validate(puma, other, unknown, settings=EXACT)
    fewer = replace(stated(estimate), residual=np.ones(5))
    with pytest.raises(SettingsError, match="residuals of 5 channels"):
        validate(puma, other, fewer, settings=EXACT)
