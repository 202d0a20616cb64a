"""Estimates: exact without noise, within their sigma with it, and blind to the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import joint_forces
from testbed.errors import RecordingError, UnknownName, UnseenParameters
from testbed.identification.estimate import METHODS, Method
from testbed.identification.filters import ROW_ATTENUATION, low_pass, motion_taps, slope_weights
from testbed.recordings.recording import Recording
from tests.helpers.ideal import EXACT, ideal, plus, true_values
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT
from tests.helpers.robots import random_robot
from tests.helpers.runs import robot


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(12))
def test_without_noise_the_model_file_comes_back(seed: int, method: Method) -> None:
    """Random trees, prismatic joints and branches included."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 1 + seed % 5).tree()
    joints = tuple(replace(j, coulomb=rng.uniform(1, 5), viscous=2.0) for j in tree.joints)
    tree = replace(tree, joints=joints)
    estimate = tb.identify(tree, ideal(tree, seed=seed), method, settings=EXACT)
    expected = true_values(tree, method)
    error = np.abs(estimate.values - expected).max() / np.abs(expected).max()
    assert error <= 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_the_estimator_cannot_see_the_truth(
    method: Method, puma: tb.Tree, puma_recording: Recording
) -> None:
    """Other masses, other friction, a falsified truth: the estimate is the same to the bit."""
    assert puma_recording.truth is not None
    honest = tb.identify(puma, puma_recording, method)
    heavy = replace(
        puma,
        inertias=tuple(tb.Inertia.about_centre(9, [1, 2, 3], np.eye(3)) for _ in puma.inertias),
        joints=tuple(replace(j, coulomb=99.0, viscous=99.0) for j in puma.joints),
    )
    lie = replace(puma_recording.truth, position=np.full_like(puma_recording.position, 7.0))
    for tree, recording in (
        (heavy, puma_recording),
        (puma, replace(puma_recording, truth=lie)),
        (puma, replace(puma_recording, truth=None)),
    ):
        other = tb.identify(tree, recording, method)
        np.testing.assert_array_equal(other.values, honest.values)
        np.testing.assert_array_equal(other.covariance, honest.covariance)


@pytest.mark.slow
def test_ten_seconds_of_table6_are_within_their_sigma(
    puma: tb.Tree, puma_recording: Recording
) -> None:
    """Encoders of 1e-4 rad, plate of 0.5 N and 0.1 Nm, friction on; fixed seed."""
    estimate = tb.identify(puma, puma_recording, "external", zeros=True)
    truth = true_values(puma, "external", zeros=True)
    z = (estimate.values - truth) / estimate.sigma
    assert np.abs(z).max() < 3.5
    relative = (estimate.values - truth) / truth
    assert np.sqrt(np.mean(relative[:9] ** 2)) < 1.5e-3


@pytest.mark.slow
def test_torques_are_far_worse_than_the_plate(puma: tb.Tree, puma_recording: Recording) -> None:
    """Friction estimated, torque constants a few percent off: the paper's point."""
    errors = []
    for method in METHODS:
        estimate = tb.identify(puma, puma_recording, method, zeros=True)
        truth = true_values(puma, method, zeros=True)
        errors.append(np.sqrt(np.mean((estimate.values[:9] / truth[:9] - 1) ** 2)))
    assert errors[1] > 50 * errors[0]


@pytest.mark.slow
def test_with_exact_torque_constants_friction_is_found(puma: tb.Tree) -> None:
    settings = ["motion.duration=10", "simulation.step=2.5e-4", "motion.candidates=10"]
    settings += [f"measurement.torque_constant_error.{j}=0.0" for j in puma.names]
    recording = tb.simulate(tb.Experiment.load(ROOT / "experiments/table6.toml", settings))
    estimate = tb.identify(puma, recording, "internal", zeros=True)
    truth = true_values(puma, "internal", zeros=True)
    np.testing.assert_allclose(estimate.values[9:], truth[9:], rtol=0.05)


def coverage(draws: int, correlation: float) -> Array:
    """Share of draws in which 95 % intervals hold the truth, per parameter."""
    tree = random_robot(np.random.default_rng(4), 2).tree()
    clean = ideal(tree, duration=20.0, rate=100.0)
    truth, inside = true_values(tree, "external"), []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        noise = rng.normal(size=clean.measured("wrench").shape) * [0.5, 0.5, 0.5, 0.1, 0.1, 0.1]
        for k in range(1, len(noise)):
            noise[k] += correlation * noise[k - 1]
        noisy = plus(clean, wrench=noise)
        estimate = tb.identify(tree, noisy, "external", settings=tb.Settings(cutoff=5.0))
        inside.append(np.abs(estimate.values - truth) < 1.96 * estimate.sigma)
    share: Array = np.mean(inside, axis=0)
    return share


@pytest.mark.parametrize("correlation", [0.0, 0.7])
@pytest.mark.slow
def test_sigma_is_honest(correlation: float) -> None:
    """White and coloured plate noise: 95 % intervals hold the truth about 95 % of the time."""
    found = coverage(60, correlation)
    assert 0.92 <= found.mean() <= 0.985
    assert found.min() >= 0.86


def test_a_joint_that_does_not_move_leaves_its_parameters_unseen(puma: tb.Tree) -> None:
    clean = ideal(puma)
    frozen = np.array([1.0, 1.0, 0.0])
    states = tb.Motion(
        clean.time,
        clean.position * frozen,
        *(part * frozen for part in (clean.truth.velocity, clean.truth.acceleration)),  # type: ignore[union-attr]
    )
    still = replace(
        clean,
        position=states.q,
        velocity=states.qd,
        acceleration=states.qdd,
        torque=joint_forces(puma, states),
        wrench=tb.base_wrench(puma, states),
    )
    with pytest.raises(UnseenParameters, match="cannot tell apart") as caught:
        tb.identify(puma, still, "external", zeros=True, settings=EXACT)
    assert "K3yy" in caught.value.names
    assert "mbar1" not in caught.value.names


@pytest.mark.parametrize("cutoff", [5.0, "off"])
@pytest.mark.parametrize("way", ["backwards", "still"])
def test_time_that_does_not_increase_is_said(
    cutoff: float | Literal["off"], way: str, puma: tb.Tree, tmp_path: Path
) -> None:
    """Whatever the filters: a file's sampling rate is that of its first and last time."""
    recording = ideal(puma, duration=3.0)
    time = recording.time[::-1] if way == "backwards" else np.zeros_like(recording.time)
    replace(recording, time=time.copy()).save(tmp_path / "r.parquet")
    settings = tb.Settings(cutoff=cutoff, position_cutoff="off")
    with pytest.raises(RecordingError, match="time does not increase"):
        tb.identify(puma, str(tmp_path / "r.parquet"), settings=settings)


def test_too_short_a_recording_is_said_to_be_too_short(puma: tb.Tree) -> None:
    with pytest.raises(RecordingError, match="too short"):
        tb.identify(puma, ideal(puma, duration=0.5), "external")


@pytest.mark.parametrize("cutoff", [1e-3, 1e-9, 1e-300, 5e-324])
@pytest.mark.parametrize("method", ["external", "internal"])
def test_a_filter_longer_than_any_recording_is_never_made(
    cutoff: float, method: Method, puma: tb.Tree
) -> None:
    for cutoffs in ({"cutoff": cutoff}, {"cutoff": cutoff, "position_cutoff": 2 * cutoff}):
        with pytest.raises(RecordingError, match="too short: the filters take .* s at each end"):
            tb.identify(puma, ideal(puma), method, settings=tb.Settings(**cutoffs))  # type: ignore[arg-type]


def test_a_filter_faster_than_the_recording_is_refused(puma: tb.Tree) -> None:
    with pytest.raises(RecordingError, match="too few for a filter at 150 Hz"):
        tb.identify(
            puma, ideal(puma), "external", settings=tb.Settings(position_cutoff="off", cutoff=150.0)
        )


def test_an_unknown_method_is_refused(puma: tb.Tree) -> None:
    with pytest.raises(UnknownName, match="known: external, internal"):
        tb.identify(puma, ideal(puma), "plate")  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_recording_without_a_tare_takes_the_pedestal_from_the_model(
    puma: tb.Tree, puma_recording: Recording
) -> None:
    told = tb.identify(puma, puma_recording, zeros=True)
    silent = tb.identify(puma, replace(puma_recording, tare=None), zeros=True)
    np.testing.assert_allclose(silent.values, told.values, rtol=1e-12)
    assert any("pedestal" in warning for warning in silent.warnings)


@pytest.mark.slow
def test_the_gravity_of_the_recording_counts(puma: tb.Tree) -> None:
    """Recorded on the moon, identified with a model file that says earth."""
    settings = ["motion.duration=10", "motion.candidates=3", "gravity=[0.0, 0.0, -1.62]"]
    moon = tb.simulate(tb.Experiment.load(ROOT / "experiments/table6.toml", settings))
    estimate = tb.identify(puma, moon, zeros=True)
    mass = dict(zip(estimate.names, estimate.values, strict=True))["mbar1"]
    assert mass == pytest.approx(20.0, rel=1e-3)


@pytest.mark.slow
def test_a_term_of_the_model_file_that_the_settings_leave_out_is_a_warning(
    puma: tb.Tree, puma_recording: Recording
) -> None:
    """One line for all joints, and only the internal method feels it."""
    geared = replace(puma, joints=tuple(replace(j, rotor_inertia=1.0) for j in puma.joints))
    with_rotor = tb.Settings(terms=("coulomb", "viscous", "rotor"))
    cases: tuple[tuple[Method, tb.Settings, int], ...] = (
        ("internal", tb.Settings(), 1),
        ("internal", with_rotor, 0),
        ("external", tb.Settings(), 0),
    )
    for method, settings, count in cases:
        found = tb.identify(geared, puma_recording, method, zeros=True, settings=settings)
        said = [w for w in found.warnings if "'rotor' of waist, shoulder, elbow" in w]
        assert len(said) == count


def test_poorly_determined_parameters_are_reported_by_name(puma: tb.Tree) -> None:
    clean = ideal(puma, duration=3.0)
    noise = np.random.default_rng(0).normal(size=clean.measured("wrench").shape) * 20
    estimate = tb.identify(puma, plus(clean, wrench=noise), "external")
    assert any("poorly determined" in warning for warning in estimate.warnings)


def applied(taps: Array, values: Array) -> Array:
    """A kernel run over a signal; the ends that it does not reach are left out."""
    return np.convolve(values, taps[::-1], "valid")


@pytest.mark.parametrize("cutoff", [None, 40.0])
def test_derivatives_are_exact_on_polynomials(cutoff: float | None) -> None:
    taps = motion_taps(500.0, cutoff)
    half = taps.shape[1] // 2
    t = np.arange(-300, 301) / 500
    position, velocity, acceleration = (applied(each, t**3 - t**2 + t) for each in taps)
    inner = t[half:-half]
    # a low-pass without phase adds to a cubic what its width makes of the curvature
    width = np.sum(taps[0] * (np.arange(-half, half + 1) / 500) ** 2)
    expected = inner**3 - inner**2 + inner + width * (3 * inner - 1)
    np.testing.assert_allclose(position, expected, atol=1e-12)
    np.testing.assert_allclose(velocity, 3 * inner**2 - 2 * inner + 1 + 3 * width, atol=1e-10)
    np.testing.assert_allclose(acceleration, 6 * inner - 2, atol=1e-8)


def test_positions_pass_unchanged_below_a_quarter_of_the_cutoff() -> None:
    rate, cutoff = 1000.0, 40.0
    taps = motion_taps(rate, cutoff)
    for f in (0.1, 1.0, 5.0, 10.0):
        t = np.arange(3000) / rate
        half = taps.shape[1] // 2
        inner = t[half:-half]
        w = 2 * np.pi * f
        expected = (np.sin(w * inner), w * np.cos(w * inner), -(w**2) * np.sin(w * inner))
        for kernel, value, tolerance in zip(taps, expected, (2e-6, 2e-6, 2e-6), strict=True):
            error = np.abs(applied(kernel, np.sin(w * t)) - value).max() / np.abs(value).max()
            assert error <= tolerance


def test_the_filter_has_no_phase_half_gain_at_its_cutoff_and_stops_beyond() -> None:
    taps = low_pass(1000.0, 5.0, ROW_ATTENUATION)
    np.testing.assert_allclose(taps, taps[::-1], rtol=1e-12)
    assert taps.sum() == pytest.approx(1.0, rel=1e-12)
    offsets = np.arange(len(taps)) - len(taps) // 2

    def gain(f: float) -> float:
        return float(np.sum(taps * np.cos(2 * np.pi * f * offsets / 1000)))

    assert gain(5.0) == pytest.approx(0.5, abs=0.01)
    assert gain(1.0) == pytest.approx(1.0, abs=2e-3)
    assert all(abs(gain(f)) < 2e-3 for f in (9.0, 20.0, 50.0, 333.0))


def test_a_filter_of_one_sample_makes_no_slope() -> None:
    np.testing.assert_array_equal(slope_weights(np.ones(1), np.zeros(1), 100.0), [0.0])


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "a_second"), [("white", 4.0), ("ar", 2.0)])
def test_rows_are_as_many_as_the_filter_leaves(
    noise: Literal["white", "ar"], a_second: float
) -> None:
    """For an autoregression as many as are independent, else twice that: for each Hz of it."""
    tree = robot("ur5")
    for cutoff in (2.5, 5.0):
        settings = tb.Settings(noise=noise, cutoff=cutoff, position_cutoff="off")
        estimate = tb.identify(tree, measured(tree, duration=20.0), settings=settings)
        rows = float(estimate.normal_equations.used[0])
        assert rows == pytest.approx(a_second * cutoff * 20.0, rel=0.15)
