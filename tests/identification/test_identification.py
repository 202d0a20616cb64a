"""Estimates: exact without noise, within their sigma with it, and blind to the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.arrays import Array
from testbed.errors import RecordingError, UnseenParameters
from testbed.identification.estimate import METHODS, Method
from testbed.identification.filters import (
    ROW_ATTENUATION,
    low_pass,
    motion_taps,
    slope_weights,
)
from testbed.identification.period import period_of
from testbed.identification.predict import own_torque, predictions
from testbed.recordings.recording import Recording
from testbed.robot.friction import LAWS, OFFSET, JointLaw
from tests.helpers.ideal import EXACT, ideal, true_values
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.runs import robot
from tests.helpers.strategies import few, rngs

KINDS = tuple(law.kind for law in LAWS)
NAMED = {"coulomb": "coulomb", "viscous": "viscous", "rotor": "rotor_inertia"}


def with_drives(tree: tb.Tree, rng: np.random.Generator, kinds: tuple[str, ...] = KINDS) -> tb.Tree:
    """With friction and rotors of some kinds at every joint."""
    joints = []
    for joint in tree.joints:
        own: dict[str, Any] = {NAMED[k]: rng.uniform(0.5, 2) for k in kinds if k in NAMED}
        joints.append(replace(joint, **own))
    return replace(tree, joints=tuple(joints))


def motion_of(recording: Recording) -> tb.Motion:
    parts = (recording.position, recording.velocity, recording.acceleration)
    return tb.Motion(recording.time, *parts)  # type: ignore[arg-type]


def rank(tree: tb.Tree, recording: Recording, kinds: tuple[str, ...]) -> int:
    """Of the torque regressor with all terms' columns: what can be told at all."""
    motion = motion_of(recording)
    parts = [tb.regressor(tree, motion, tb.minimal_set(tree, "dynamic"))]
    for law in LAWS:
        if law.kind in kinds:
            columns = np.broadcast_to(law.column(motion.qd, motion.qdd), motion.qd.shape)
            parts.append(columns[:, :, None] * np.eye(tree.n))
    phi = np.concatenate(parts, axis=2).reshape(motion.qd.size, -1)
    scale = np.linalg.norm(phi, axis=0)
    return int(np.linalg.matrix_rank(phi / np.where(scale > 0, scale, 1.0), tol=1e-8))


@few(25)
@given(rngs, st.integers(1, 6), st.sets(st.sampled_from(KINDS), max_size=4))
def test_without_noise_the_model_file_comes_back(
    rng: np.random.Generator, joints: int, some: set[str]
) -> None:
    """Of any tree by both methods, with any terms: as many unknowns as a rank says."""
    kinds = tuple(kind for kind in KINDS if kind in some)
    tree = with_drives(random_robot(rng, joints).tree(), rng, kinds)
    offsets = np.linspace(-1, 1, joints) * ("offset" in kinds)
    recording = ideal(tree, own={OFFSET: offsets})
    plate = tb.identify(tree, recording, settings=EXACT)
    assert np.abs(plate.values - true_values(tree, "external")).max() <= 1e-10
    asked = replace(EXACT, terms=kinds, deadband=0.0)
    found = tb.identify(tree, recording, "internal", settings=asked)
    assert len(set(found.names)) == len(found.names) == rank(tree, recording, kinds)
    assert found.drives is not None
    truth = found.drives.values(tb.barycentric(tree), tree)
    for k, term in enumerate(found.drives.terms, start=found.minimal.count):
        if term.law is OFFSET:
            truth[k] += offsets[term.joint]
    assert np.abs(found.values - truth).max() <= 1e-8 * np.abs(truth).max()


@pytest.mark.parametrize("compiled", [False, True])
def test_a_law_of_ones_own_goes_all_the_way(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Defined here and nowhere else: recorded, identified and foretold, whatever the engine."""
    monkeypatch.setattr("testbed.identification.passes.SMALL", 0.0 if compiled else 1e9)
    law = JointLaw("cubic", "N m s^3/rad^3", "N s^3/m^3", lambda qd, qdd: qd**3)
    tree = robot("gantry")
    coefficients = np.linspace(0.5, 3.0, tree.n)
    recording = ideal(tree, own={law: coefficients})
    asked = replace(EXACT, terms=("coulomb", law, "viscous"))
    found = tb.identify(tree, recording, "internal", settings=asked)
    terms = [term for term in found.joint_terms if term.kind == "cubic"]
    assert [term.name for term in terms] == [f"cubic/{name}" for name in tree.names]
    assert [term.unit for term in terms] == [law.unit(joint) for joint in tree.joints]
    np.testing.assert_allclose([term.value for term in terms], coefficients, rtol=1e-8)
    motion = motion_of(recording)
    torque = predictions(tree, recording, motion, {"internal": found})[1]["internal"]
    np.testing.assert_allclose(torque, recording.measured("torque"), atol=1e-7)
    np.testing.assert_allclose(own_torque(motion, found), coefficients * motion.qd**3, atol=1e-7)


def test_an_estimate_knows_its_parts(puma: tb.Tree) -> None:
    """A rotor that a body hides is named with it; the elbow's is told from its body."""
    tree = with_drives(puma, np.random.default_rng(0))
    asked = replace(EXACT, terms=("coulomb", "viscous", "rotor"), zeros=True)
    found = tb.identify(tree, ideal(tree), "internal", settings=asked)
    base, terms = found.base, found.joint_terms
    assert (*base.names, *(term.name for term in terms)) == found.names
    assert (*base.units, *(term.unit for term in terms)) == found.units
    joined = [*base.values, *(term.value for term in terms)]
    np.testing.assert_array_equal(joined, found.values)
    np.testing.assert_array_equal([*base.sigma, *(term.sigma for term in terms)], found.sigma)
    np.testing.assert_array_equal(np.sqrt(np.diagonal(base.covariance)), base.sigma)
    own = dict(zip(found.names, found.values, strict=True))
    plain = tb.minimal_set(puma, "dynamic", zeros=True)
    bodies = dict(zip(plain.names, plain.values(tb.barycentric(puma)), strict=True))
    rotors = [joint.rotor_inertia for joint in tree.joints]
    for name, joint, rotor in zip(("K*1zz", "K*2yy"), tree.names, rotors, strict=False):
        assert own[f"{name}+rotor/{joint}"] == pytest.approx(bodies[name] + rotor, rel=1e-9)
    assert own["rotor/elbow"] == pytest.approx(rotors[2], rel=1e-9)
    assert [term.joint for term in terms if term.kind == "rotor"] == ["elbow"]
    for array in (base.values, found.values, found.covariance, found.residual):
        assert not array.flags.writeable


@pytest.fixture(scope="module")
def puma_recording() -> Recording:
    """Ten seconds of the PUMA through the instrument of table6."""
    settings = ["motion.duration=10", "simulation.step=2.5e-4", "motion.candidates=10"]
    return tb.simulate(tb.Experiment.load(ROOT / "experiments/table6.toml", settings))


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
def test_the_papers_point_the_plate_is_far_better_than_the_torques(
    puma: tb.Tree, puma_recording: Recording
) -> None:
    """Ten seconds of table6: the plate's errors are within sigma; torque constants are off."""
    errors = []
    for method in METHODS:
        found = tb.identify(puma, puma_recording, method, zeros=True)
        truth = true_values(puma, method, zeros=True)
        errors.append(np.sqrt(np.mean((found.values[:9] / truth[:9] - 1) ** 2)))
        if method == "external":
            assert np.abs((found.values - truth) / found.sigma).max() < 3.5
    assert errors[0] < 1.5e-3
    assert errors[1] > 50 * errors[0]
    silent = tb.identify(puma, replace(puma_recording, tare=None), zeros=True)
    told = tb.identify(puma, puma_recording, zeros=True)
    np.testing.assert_allclose(silent.values, told.values, rtol=1e-12)
    assert len(silent.warnings) == len(told.warnings) + 1  # the pedestal's weight is the model's


def test_parameters_that_a_motion_does_not_show_are_named(puma: tb.Tree) -> None:
    """A joint rests; or noise is large, which is a warning that names them."""
    clean = ideal(puma)
    frozen = np.array([1.0, 1.0, 0.0])
    states = motion_of(clean)
    still = tb.Motion(states.t, states.q * frozen, states.qd * frozen, states.qdd * frozen)
    rates = {"position": still.q, "velocity": still.qd, "acceleration": still.qdd}
    resting = replace(clean, **rates, wrench=tb.base_wrench(puma, still))  # type: ignore[arg-type]
    with pytest.raises(UnseenParameters) as caught:
        tb.identify(puma, resting, settings=replace(EXACT, zeros=True))
    assert "K3yy" in caught.value.names
    assert "mbar1" not in caught.value.names
    loose = tb.identify(puma, measured(puma, noise=300.0, duration=10.0))
    poor = np.abs(loose.sigma / loose.values) > 0.3
    assert poor.sum() > 6
    named = [sum(f"{name} (" in line for name in loose.names) for line in loose.warnings]
    assert 6 in named  # the worst; the others are counted


def test_a_recording_that_cannot_be_filtered_is_refused(puma: tb.Tree, tmp_path: Path) -> None:
    """Too short for its filters, too slow for them, or its time does not go on."""
    whole = ideal(puma)
    cases: list[tuple[Recording, dict[str, Any], str]] = [
        (ideal(puma, duration=0.5), {}, "0.5 s"),
        (whole.part(0, 30), {}, "0.15 s"),
        (whole, {"cutoff": 1e-9}, "10 s"),
        (whole, {"cutoff": 5e-324, "position_cutoff": 1e-300}, "10 s"),
        (whole, {"cutoff": 150.0, "position_cutoff": "off"}, "150 Hz"),
    ]
    for way in (whole.time[::-1], np.zeros_like(whole.time)):
        path = tmp_path / f"{way[0]}.parquet"
        replace(whole, time=way.copy()).save(path)
        cases += [(path, {"cutoff": c, "position_cutoff": "off"}, "time") for c in (5.0, "off")]  # type: ignore[misc]
    for recording, asked, culprit in cases:
        for method in METHODS:
            with refuses(RecordingError, culprit):
                tb.identify(puma, recording, method, settings=tb.Settings(**asked))


def test_the_gravity_of_the_recording_counts(puma: tb.Tree) -> None:
    """Recorded on a leaning moon, identified with a model file that says earth."""
    moon = [0.3, -0.2, -1.62]
    there = ideal(puma.with_gravity(moon))
    said, lies = (replace(there, facts={"gravity": g}) for g in (moon, [0.0, 0.0, -9.81]))
    truth = true_values(puma.with_gravity(moon), "external")
    for recording, gravity in ((said, None), (there, moon), (lies, moon)):
        found = tb.identify(puma, recording, gravity=gravity, settings=EXACT)
        np.testing.assert_allclose(found.values, truth, atol=1e-9)


def test_a_term_of_the_model_file_that_the_settings_leave_out_is_said_once(
    puma: tb.Tree,
) -> None:
    """One line for all joints, and only the internal method feels it."""
    geared, recording = with_drives(puma, np.random.default_rng(0)), measured(puma)
    for method, terms, count in (
        ("internal", ("coulomb", "viscous"), 1),
        ("internal", ("coulomb", "viscous", "rotor"), 0),
        ("external", ("coulomb", "viscous"), 0),
    ):
        found = tb.identify(geared, recording, method, settings=tb.Settings(terms=terms))  # type: ignore[arg-type]
        said = [w for w in found.warnings if all(x in w for x in ("rotor", *puma.names))]
        assert len(said) == count


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


def test_filters_pass_what_is_slow_stop_what_is_fast_and_have_no_phase() -> None:
    """Positions below a quarter of the cutoff; rows half at theirs."""
    taps = motion_taps(1000.0, 40.0)
    half = taps.shape[1] // 2
    t = np.arange(3000) / 1000
    for w in 2 * np.pi * np.array([0.1, 1.0, 5.0, 10.0]):
        inner = w * t[half:-half]
        expected = (np.sin(inner), w * np.cos(inner), -(w**2) * np.sin(inner))
        for kernel, value in zip(taps, expected, strict=True):
            error = np.abs(applied(kernel, np.sin(w * t)) - value).max()
            assert error <= 2e-6 * np.abs(value).max()
    rows = low_pass(1000.0, 5.0, ROW_ATTENUATION)
    np.testing.assert_allclose(rows, rows[::-1], rtol=1e-12)
    angles = 2 * np.pi * (np.arange(len(rows)) - len(rows) // 2) / 1000
    gains = [float(rows @ np.cos(f * angles)) for f in (0, 1.0, 5.0, 9.0, 20.0, 50.0, 333.0)]
    np.testing.assert_allclose(gains[:3], [1.0, 1.0, 0.5], atol=0.01)
    assert gains[0] == pytest.approx(1.0, rel=1e-12)
    assert np.abs(gains[3:]).max() < 2e-3
    np.testing.assert_array_equal(slope_weights(np.ones(1), np.zeros(1), 100.0), [0.0])


def test_rows_are_as_many_as_the_filter_leaves(puma: tb.Tree) -> None:
    """For an autoregression as many as are independent, else twice that: for each Hz of it."""
    for noise, cutoff, rows in (("white", 2.5, 200), ("ar", 5.0, 200), ("ar", 2.5, 100)):
        asked: Any = {"noise": noise, "cutoff": cutoff, "position_cutoff": "off"}
        found = tb.identify(puma, ideal(puma, 20.0), settings=tb.Settings(**asked))
        assert found.normal_equations.used[0] == pytest.approx(rows, rel=0.15)


def test_four_samples_may_repeat_and_three_may_not() -> None:
    """And what rests or goes on never does."""
    turning = np.array([[1.0], [-1.0]] * 10)
    assert period_of(turning) == 2
    for odd in (turning[:3], np.ones((20, 2)), np.arange(20.0)[:, None]):
        assert period_of(odd) is None
