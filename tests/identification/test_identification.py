"""Estimates: exact without noise, as good as dense algebra gives, blind to the truth; settings."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.applications.prediction import (
    joint_term_torque,
    longest_segment_motion,
    predicted_signals,
    steady_joint_torque,
)
from testbed.core.base.errors import (
    ModelError,
    RecordingError,
    SettingsError,
    UnidentifiableParameters,
    UnknownName,
)
from testbed.core.base.frames import data_frame
from testbed.core.base.summary_table import number_with_sigma
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.windows import ROW_ATTENUATION, low_pass, motion_taps
from testbed.core.estimation.selection.term_choice import choose_terms
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.metadata import Metadata
from testbed.core.recordings.views import with_base_joints
from testbed.core.robot.free_base import base_coordinates
from testbed.core.robot.free_root import with_free_base
from testbed.core.robot.friction import JOINT_LAWS, OFFSET, ROTOR
from testbed.core.robot.joint_law import JointLaw
from tests.helpers.humanoid import G1, humanoid, squatting
from tests.helpers.ideal import EXACT, ideal, plus, true_values
from tests.helpers.measured import measured
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot, random_robot
from tests.helpers.runs import noisy, robot
from tests.helpers.strategies import Rng, few, rngs, robots, wrong_numbers
from tests.scenarios.scenarios import result

CUBIC = JointLaw("cubic", "N m s^3/rad^3", "N s^3/m^3", lambda qd, qdd: qd**3)
"""One's own, defined here and nowhere else."""

NAMED = {"coulomb": "coulomb", "viscous": "viscous", "rotor": "rotor_inertia"}


def with_drives(tree: tb.Tree, rng: Rng, kinds: Iterable[str] = NAMED) -> tb.Tree:
    """With friction and rotors of some kinds at every joint."""
    joints = []
    for joint in tree.joints:
        own: dict[str, Any] = {NAMED[k]: rng.uniform(0.5, 2) for k in kinds}
        joints.append(replace(joint, **own))
    return replace(tree, joints=tuple(joints))


def rank(tree: tb.Tree, motion: tb.Motion, laws: Iterable[JointLaw]) -> int:
    """Of the torque regressor with all terms' columns: what can be told at all."""
    parts = [tb.regressor(tree, motion, tb.minimal_set(tree, "torque"))]
    for law in laws:
        columns = np.broadcast_to(law.column(motion.qd, motion.qdd), motion.qd.shape)
        parts.append(columns[:, :, None] * np.eye(tree.n))
    phi = np.concatenate(parts, axis=2).reshape(motion.qd.size, -1)
    scale = np.linalg.norm(phi, axis=0)
    return int(np.linalg.matrix_rank(phi / np.where(scale > 0, scale, 1.0), tol=1e-8))


@few(25)
@given(
    rngs, st.integers(1, 6), st.sets(st.sampled_from([*JOINT_LAWS, CUBIC]), max_size=4),
    st.sampled_from(["compiled", "numpy"]),
)  # fmt: skip
def test_without_noise_the_model_file_comes_back(
    rng: Rng, joints: int, some: set[JointLaw], engine: Any
) -> None:
    """Of any tree by both methods, with any terms, as many as a rank says; and what happened."""
    laws = [law for law in (*JOINT_LAWS, CUBIC) if law in some]
    tree = random_robot(rng, joints).tree()
    tree = with_drives(tree, rng, [law.kind for law in laws if law.kind in NAMED])
    own = {law: np.linspace(0.5, 2, joints) for law in laws if law.kind not in NAMED}
    recording = ideal(tree, own=own)
    plate = tb.identify(tree, recording, settings=EXACT)
    assert np.abs(plate.values - true_values(tree, "wrench")).max() <= 1e-10
    asked = replace(EXACT, terms=tuple(laws), deadband=0.0, engine=engine)
    found, (motion, _) = (
        tb.identify(tree, recording, "torque", settings=asked),
        longest_segment_motion(recording),
    )
    assert len(set(found.names)) == len(found.names) == rank(tree, motion, laws)
    assert found.drives is not None
    truth = found.drives.values(tb.barycentric(tree), tree)
    for told, term in zip(found.joint_terms, found.drives.terms, strict=True):
        k = found.names.index(told.name)
        if term.law in own:
            truth[k] += own[term.law][term.joint]
        unit = term.law.unit(tree.joints[term.joint])
        assert told.name.startswith(term.name(tree))  # less what a rotor weighs
        assert (told.kind, told.unit, told.value) == (term.law.kind, unit, found.values[k])
    assert np.abs(found.values - truth).max() <= 1e-8 * np.abs(truth).max()
    felt, driven = recording.measured("wrench"), recording.measured("torque")
    both: dict[Signal, tb.Estimate] = {"torque": found, "wrench": plate}
    wrench, torque = predicted_signals(tree, recording, motion, both)
    foretold = [(wrench["wrench"], felt), (torque["torque"], driven)]
    if ROTOR not in laws:  # which may be one with a body's inertia
        foretold += [(wrench["torque"], felt)]
        foretold += [(torque["wrench"] + joint_term_torque(motion, found), driven)]
    for predicted, wanted in foretold:
        assert np.abs(predicted - wanted).max() <= 1e-8 * np.abs(wanted).max()


@pytest.mark.parametrize("method", SIGNALS)
def test_the_estimator_cannot_see_the_truth(method: Signal, puma: tb.Tree) -> None:
    """Other masses, other friction, a falsified truth: the estimate is the same to the bit."""
    noise, tare = measured(puma, duration=10.0), tb.pedestal_wrench(puma)
    assert tare.any()
    truth = ideal(puma, 10.0).truth
    honest = tb.identify(puma, noise, method)
    heavy = replace(
        puma,
        inertias=tuple(tb.Inertia.about_centre(9, [1, 2, 3], np.eye(3)) for _ in puma.inertias),
        joints=tuple(replace(j, coulomb=99.0, viscous=99.0) for j in puma.joints),
    )
    for tree, recording in (
        (heavy, noise),
        (puma, replace(noise, truth=truth)),
        (puma, replace(noise, tare=None)),  # it is the model's pedestal's
    ):
        other = tb.identify(tree, recording, method)
        np.testing.assert_array_equal(other.values, honest.values)
        np.testing.assert_array_equal(other.covariance, honest.covariance)


def test_parameters_that_a_motion_does_not_show_are_named(puma: tb.Tree) -> None:
    """A joint rests; or noise is large, which is a warning that names them."""
    clean = ideal(puma)
    frozen = np.array([1.0, 1.0, 0.0])
    states, _ = longest_segment_motion(clean)
    still = tb.Motion(states.t, states.q * frozen, states.qd * frozen, states.qdd * frozen)
    rates = {"position": still.q, "velocity": still.qd, "acceleration": still.qdd}
    resting = replace(clean, **rates, wrench=tb.base_wrench(puma, still))  # type: ignore[arg-type]
    with pytest.raises(UnidentifiableParameters) as caught:
        tb.identify(puma, resting, settings=replace(EXACT, zeros=True))
    assert "K3yy" in caught.value.names
    assert "mbar1" not in caught.value.names
    loose = tb.identify(puma, measured(puma, noise=300.0, duration=10.0))
    poor = np.abs(loose.sigma / loose.values) > 0.3
    assert poor.sum() > 6
    named = [
        sum(f"{name} (" in line for name in loose.names) for line in map(str, loose.diagnostics)
    ]
    assert 6 in named  # the worst; the others are counted


def test_a_recording_that_cannot_be_filtered_is_refused(puma: tb.Tree, tmp_path: Path) -> None:
    """Too short for its filters, too slow for them, or its time does not go on."""
    whole = ideal(puma)
    cases: list[tuple[tb.Recording | Path, Any, Any, str]] = [
        (ideal(puma, duration=0.5), 5.0, 40.0, "0.5 s"),
        (whole, 1e-9, 40.0, "10 s"),
        (whole, 5e-324, 1e-300, "10 s"),
        (whole, 150.0, "off", "150 Hz"),
    ]
    for way in (whole.time[::-1], np.zeros_like(whole.time)):
        path = tmp_path / f"{way[0]}.parquet"
        replace(whole, time=way.copy()).save(path)
        cases += [(path, 5.0, "off", "time"), (path, "off", "off", "time")]
    for recording, cutoff, position, culprit in cases:
        settings = tb.Settings(cutoff=cutoff, position_cutoff=position)
        with refuses(RecordingError, culprit):
            tb.identify(puma, recording, settings=settings)


def test_the_gravity_of_the_recording_counts(puma: tb.Tree) -> None:
    """Recorded on a leaning moon, identified with a model file that says earth."""
    moon = (0.3, -0.2, -1.62)
    there = ideal(puma.with_gravity(moon))
    said, lies = (replace(there, metadata=Metadata(gravity=g)) for g in (moon, (0.0, 0.0, -9.81)))
    truth = true_values(puma.with_gravity(moon), "wrench")
    for recording, gravity in ((said, None), (there, moon), (lies, moon)):
        found = tb.identify(puma, recording, gravity=gravity, settings=EXACT)
        np.testing.assert_allclose(found.values, truth, atol=1e-9)


def test_a_term_of_the_model_file_that_the_settings_leave_out_is_said_once(puma: tb.Tree) -> None:
    """In one line for all joints: the internal estimate takes it for the bodies'."""
    geared, recording = with_drives(puma, np.random.default_rng(0)), measured(puma)
    for terms, count in ((("coulomb", "viscous"), 1), (("coulomb", "viscous", "rotor"), 0)):
        found = tb.identify(geared, recording, "torque", settings=tb.Settings(terms=terms))
        assert [d.code for d in found.diagnostics].count("drives.term") == count


@pytest.mark.parametrize(("way", "kind"), [(1, "coulomb+offset"), (-1, "offset-coulomb"), (0, "")])
def test_one_joint_that_hardly_moves_refuses_nothing(way: int, kind: str, puma: tb.Tree) -> None:
    """Where it never reverses, dry friction and offset are their sum; of no row it has no terms."""
    tree, offset = with_drives(puma, np.random.default_rng(0), ("coulomb", "viscous")), 0.7
    whole = ideal(tree, rate=2000.0, own={OFFSET: [0.0, 0.0, offset]})
    speed = whole.measured("velocity")[:, 2]
    rows = way * speed > 0.1 if way else np.abs(speed) < 0.02
    signals = ("position", "velocity", "acceleration", "torque")
    kept: dict[str, Any] = {signal: whole.measured(signal)[rows] for signal in signals}
    part = replace(whole, time=whole.time[: rows.sum()], truth=None, wrench=None, **kept)
    asked = replace(EXACT, terms=("coulomb", "viscous", "offset"))
    found = tb.identify(tree, part, "torque", settings=asked)
    bodies = tb.minimal_set(puma, "torque").values(tb.barycentric(puma))
    np.testing.assert_allclose(found.values[: len(bodies)], bodies, atol=1e-8)
    own = {name.split("/")[0] for name in found.names if name.endswith("/elbow")}
    assert own == ({kind, "viscous"} if way else set())
    if way:
        value = found.values[found.names.index(f"{kind}/elbow")]
        assert value == pytest.approx(offset + way * tree.joints[2].coulomb)
        assert (tb.validate(found, part).residual < 1e-8).all()
    assert [d.code for d in found.diagnostics].count("drives.one-way") == abs(way)


def test_filters_pass_what_is_slow_stop_what_is_fast_and_have_no_phase() -> None:
    """Positions below a quarter of the cutoff, with both derivatives; rows half at theirs."""
    taps = motion_taps(1000.0, 40.0)
    half, t = taps.shape[1] // 2, np.arange(3000) / 1000
    for w in 2 * np.pi * np.array([0.1, 1.0, 5.0, 10.0]):
        inner = w * t[half:-half]
        expected = (np.sin(inner), w * np.cos(inner), -(w**2) * np.sin(inner))
        for kernel, value in zip(taps, expected, strict=True):
            error = np.convolve(np.sin(w * t), kernel[::-1], "valid") - value
            assert np.abs(error).max() <= 2e-6 * np.abs(value).max()
    rows = low_pass(1000.0, 5.0, ROW_ATTENUATION)
    np.testing.assert_allclose(rows, rows[::-1], rtol=1e-12)
    angles = 2 * np.pi * (np.arange(len(rows)) - len(rows) // 2) / 1000
    gains = [float(rows @ np.cos(f * angles)) for f in (0, 1.0, 5.0, 9.0, 20.0, 50.0, 333.0)]
    np.testing.assert_allclose(gains[:3], [1.0, 1.0, 0.5], atol=0.01)
    assert gains[0] == pytest.approx(1.0, rel=1e-12)
    assert np.abs(gains[3:]).max() < 2e-3


@pytest.mark.parametrize("method", SIGNALS)
def test_a_fit_of_some_channels_is_the_fit_of_their_rows(method: Signal) -> None:
    """By weight, and by leaving the rows of the others out of a dense problem."""
    tree = random_robot(np.random.default_rng(4), 3).tree()
    recording = noisy(ideal(tree))
    settings = replace(EXACT, terms=(), deadband=0.0)
    estimate = tb.identify(tree, recording, method, settings=settings)
    left = {name: 1.0 + k for k, name in enumerate(estimate.channels) if k != 1}
    phi = tb.regressor(tree, longest_segment_motion(recording)[0], estimate.minimal)
    y = recording.measured(method)
    keep = [k for k, name in enumerate(estimate.channels) if name in left]
    root = np.sqrt([left[estimate.channels[k]] for k in keep])
    a = (phi[:, keep] * root[:, None]).reshape(-1, estimate.minimal.count)
    expected = np.linalg.lstsq(a, (y[:, keep] * root).ravel(), rcond=None)[0]
    found = tb.fit(estimate.normal_equations, left)
    seen = ~np.isnan(found.values)
    scale = np.abs(expected).max()
    assert np.abs(found.values[seen] - expected[seen]).max() <= 1e-9 * scale
    assert not a[:, ~seen].any()
    with refuses(UnknownName, "Mq"):
        tb.fit(estimate.normal_equations, {"Mq": 1.0})


def test_channels_weigh_as_their_own_residuals_say(puma: tb.Tree) -> None:
    """However unlike their noise is: a poor channel does not spoil a good one."""
    noise = np.random.default_rng(0).normal(size=(400, 6)) * [5.0, 0.5, 0.5, 0.1, 0.01, 1.0]
    recording = plus(ideal(puma, 2.0), wrench=noise)
    equations = tb.identify(puma, recording, settings=EXACT).normal_equations
    found = tb.fit(equations)
    free = equations.used - len(equations.unknowns) / 6
    left = equations.residual(found.values) / free
    np.testing.assert_allclose(found.weights * left, 1.0, atol=1e-5)


@pytest.mark.parametrize("exponent", [0, 3, 5, 7])
def test_as_accurate_as_lstsq_up_to_a_condition_of_a_million(exponent: int) -> None:
    """Two joints and one that moves less and less; without noise, against lstsq of all rows."""
    tree = random_robot(np.random.default_rng(12), 3).tree()
    clean, small = ideal(tree, duration=20.0), np.array([1.0, 1.0, 10.0**-exponent])
    full, _ = longest_segment_motion(clean)
    offset = np.array([0.0, 0.0, 0.3])
    motion = tb.Motion(full.t, full.q * small + offset, full.qd * small, full.qdd * small)
    minimal = tb.minimal_set(tree, "wrench")
    phi = tb.regressor(tree, motion, minimal).reshape(-1, minimal.count)
    wrench = (phi @ minimal.values(tb.barycentric(tree))).reshape(-1, 6)
    rates: dict[str, Any] = {"velocity": motion.qd, "acceleration": motion.qdd}
    recording = replace(clean, position=motion.q, wrench=wrench, **rates)
    estimate = tb.identify(tree, recording, settings=EXACT)
    scale = np.linalg.norm(phi, axis=0)
    plain = np.linalg.lstsq(phi / scale, wrench.ravel(), rcond=None)[0]
    truth = minimal.values(tb.barycentric(tree)) * scale
    ours, theirs = (
        np.linalg.norm(each - truth) / np.linalg.norm(truth)
        for each in (estimate.values * scale, plain)
    )
    assert 10.0**exponent < estimate.condition < 200 * 10.0**exponent
    assert ours <= (3 * max(float(theirs), 4e-15) if estimate.condition <= 1e6 else 1e-6)


@pytest.mark.parametrize("geared", [2, 3])
def test_rotors_of_the_file_are_terms_and_bodies_come_out_right(geared: int, puma: tb.Tree) -> None:
    """Simulated or imported."""
    tree = puma.with_joints({name: {"rotor_inertia": 0.3} for name in puma.names[:geared]})
    for metadata in (Metadata(), Metadata(mapping={})):
        recording = replace(ideal(tree), truth=None, metadata=metadata)
        found = tb.identify(tree, recording, "torque", settings=EXACT)
        assert found.drives is not None
        rotors = [t.joint for t in found.drives.asked if t.law.kind == "rotor"]
        assert rotors == [*range(geared)]
        truth = found.drives.values(tb.barycentric(tree), tree)
        np.testing.assert_allclose(found.values, truth, atol=1e-6)
        exact = ideal(tree).truth
        assert exact is not None
        np.testing.assert_allclose(
            steady_joint_torque(exact.velocity, found), exact.friction, atol=1e-6
        )
        (said,) = (each.subject for each in found.diagnostics if each.code == "drives.rotor")
        assert said.split(", ") == [name for name in found.names if "+rotor/" in name]


# settings, and estimates as they are printed

NUMBERS = ("position_cutoff", "cutoff", "deadband", "reversal_reach")
CHOICES = ("tare", "drives", "engine")
TWIN = JointLaw("viscous", "N m s/rad", "N s/m", lambda qd, qdd: qd)
MEANINGLESS: tuple[tuple[dict[str, Any], str], ...] = (
    ({"cutoff": 0.0}, "cutoff"),
    ({"position_cutoff": 6.0, "cutoff": 5.0}, "twice cutoff = 5 Hz"),  # it would bias the estimate
    ({"terms": ("rotr",)}, "'rotor'"),
    ({"terms": ("rotor", "rotor")}, "terms"),
    ({"terms": ("viscous", TWIN)}, "terms"),
    ({"terms": "rotor"}, "terms"),
    ({"terms": (3,)}, "3"),
    ({"zeros": 1}, "zeros"),
    ({"zeros": [1, 2]}, "zeros"),
    ({"nuisances": ("skw",)}, "'skew'"),
    ({"nuisances": ("skew", "skew")}, "nuisances"),
    ({"nuisances": ("skew",), "cutoff": "off"}, "nuisances"),
    *(({"known": {"mass": given}}, "known") for given in ("20", (1, -1), (1, 2, 3))),
    *(({"span": s}, "span") for s in ([1.0], [2.0, 1.0], [1.0, 1.0], "ab", ["a", 2], [0, np.inf])),
)


@given(wrong_numbers)
def test_what_is_no_number_is_refused_by_the_settings_name(wrong: Any) -> None:
    for name in NUMBERS:
        if wrong is not None or name == "deadband":  # elsewhere: the default
            with refuses(SettingsError, name):
                tb.Settings(**{name: wrong})


def test_what_makes_no_sense_is_refused_by_the_settings_name() -> None:
    for given_settings, culprit in MEANINGLESS:
        with refuses((SettingsError, UnknownName), culprit):  # type: ignore[arg-type]
            tb.Settings(**given_settings)
    for name in CHOICES:
        with refuses(SettingsError, name, "'nonsense'"):
            tb.Settings(**{name: "nonsense"})  # type: ignore[arg-type]


def test_filters_fit_the_sampling_rate_unless_they_are_said() -> None:
    for rate, position, rows in ((1000.0, 40.0, 5.0), (60.0, None, 5.0), (30.0, None, 3.0)):
        fitted = tb.Settings().fitted(rate)
        assert (fitted.position_low_pass, fitted.row_low_pass) == (position, rows)
    asked = tb.Settings(position_cutoff=10.0, cutoff=2.0)
    assert asked.fitted(30.0) == asked
    none, off = (tb.Settings(position_cutoff=v, cutoff=v) for v in (None, "off"))
    assert none == off == off.fitted(30.0)
    assert (off.position_low_pass, off.row_low_pass) == (None, None)
    assert tb.Settings(position_cutoff=np.float64(40), cutoff=5) == tb.Settings().fitted(1000.0)


def test_known_zeros_are_left_out_and_an_argument_overrides_the_setting(puma: tb.Tree) -> None:
    """Three bodies on a line: some of their parameters are zero in the model file."""
    recording, with_zeros = ideal(puma), replace(EXACT, zeros=True)
    truth = true_values(puma, "wrench", zeros=True)
    for settings, zeros, count in (
        (EXACT, None, 20),
        (with_zeros, None, len(truth)),
        (EXACT, True, len(truth)),
        (with_zeros, False, 20),
        (EXACT, ["K3xy"], 19),
    ):
        found = tb.identify(puma, recording, settings=settings, zeros=zeros)
        assert len(found.names) == count
        if count == len(truth):
            np.testing.assert_allclose(found.values, truth, rtol=1e-9)


def test_what_does_not_fit_the_robot_or_the_recording_is_refused_by_name() -> None:
    tree = robot("ur5")
    recording = noisy(ideal(tree))
    nothing = tb.Inertia.about_centre(0.0, np.zeros(3), np.zeros((3, 3)))
    light, zeros = replace(tree, inertias=(nothing,) * tree.n), replace(EXACT, zeros=True)
    estimate = tb.identify(tree, recording)
    elsewhere, short = replace(estimate, gravity=np.ones(3)), measured(tree, duration=0.8)
    cases: tuple[tuple[type[Exception], str, Callable[[], object]], ...] = (
        (SettingsError, "gravity", lambda: tb.payload(tree, estimate, elsewhere)),
        (SettingsError, "zeros", lambda: tb.identify(light, recording, settings=zeros)),
        (UnknownName, "plate", lambda: tb.identify(tree, recording, "plate")),  # type: ignore[arg-type]
        (UnknownName, "static", lambda: tb.minimal_set(tree, "static")),  # type: ignore[arg-type]
        (
            RecordingError,
            "rows",
            lambda: choose_terms(Problem.from_recording(tree, short, "torque")),
        ),
    )
    for kind, culprit, asked in cases:
        with refuses(kind, culprit):
            asked()


def test_every_form_holds_every_parameter() -> None:
    """Warnings too, and safely; data frames by whichever package is there."""
    found = replace(
        result("gantry").estimates["torque"],
        diagnostics=(tb.Diagnostic("note", "<b>mind</b> this"),),
    )
    lines = str(found).splitlines()
    for name, value, sigma, unit, line in zip(
        found.names, found.values, found.sigma, found.units, lines[1:-1], strict=True
    ):
        words = (name, number_with_sigma(float(value), float(sigma)), unit)
        assert [part for part in words if part not in line] == []
    assert "<b>mind</b> this" in lines[-1]
    page = found._repr_html_()
    assert page.count("<tr>") == len(found.names)
    assert "&lt;b&gt;mind" in page
    np.testing.assert_array_equal(np.asarray(found.to_frame()["sigma"]), found.sigma)
    with refuses(tb.TestbedError, "sparrow"):
        data_frame({"sigma": found.sigma}, "sparrow")


def test_a_number_has_the_digits_that_its_sigma_has_to_say() -> None:
    for value, sigma, wanted, short in (
        (1.06104, 0.00094, "1.06104 +- 0.00094", "1.06104(94)"),
        (-123.456, 12.0, "-123.5 +- 12.0", "-123.5(12.0)"),
        (5.0, 1.0, "5.0 +- 1.0", "5.0(1.0)"),
        (1.0, 1e-12, "1 +- 1e-12", "1 +- 1e-12"),
        (2.5, 0.0, "2.5", "2.5"),
        (1e-17, 1e-18, "0", "0"),
    ):
        assert (number_with_sigma(value, sigma), number_with_sigma(value, sigma, True)) == (
            wanted,
            short,
        )
    assert not any(digit in number_with_sigma(3.0, np.inf) for digit in "0123456789")


def rank_by_pinocchio(model: pin.Model, states: int) -> int:
    """Of a free root's rows on all standard parameters at random states: no code of ours."""
    rng, data, rows = np.random.default_rng(0), model.createData(), []
    for _ in range(states):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.5, 1.5, model.nv))
        v, a = rng.uniform(-3, 3, (2, model.nv))
        rows.append(pin.computeJointTorqueRegressor(model, data, q, v, a)[:6].copy())
    whole = np.concatenate(rows)
    size = np.linalg.norm(whole, axis=0)
    return int(np.linalg.matrix_rank(whole / np.where(size > 0, size, 1.0), tol=1e-8))


@given(robots((1, 6)))
def test_the_minimal_set_is_as_large_as_pinocchios_rank(robot: Robot) -> None:
    """Under gravity and without it: else normal equations are singular, or something is lost."""
    model = pin.buildModelFromXML(robot.urdf(), pin.JointModelFreeFlyer())
    free = with_free_base(robot.tree())
    model.gravity.linear = free.gravity
    found = tb.minimal_set(free, "wrench")
    sliding = sum(not joint.revolute for joint in robot.tree().joints)
    assert found.count == rank_by_pinocchio(model, 10 + 2 * free.n)
    assert found.count == 10 + 7 * robot.tree().n - 3 * sliding


def test_the_grounds_wrench_is_pinocchios() -> None:
    """Of a humanoid, and 213 parameters; else a robot on a moving base is estimated as another."""
    tree, recording = humanoid(3.0, 100.0, 1, 0.0)
    free = with_free_base(tree)
    path = squatting(tree, 1).at(recording.time)
    np.testing.assert_allclose(tb.base_wrench(free, path), recording.measured("wrench"), atol=2e-5)
    np.testing.assert_allclose(with_base_joints(recording).position, path.q, atol=1e-12)
    model = pin.buildModelFromUrdf(str(G1), pin.JointModelFreeFlyer())
    assert tb.minimal_set(free, "wrench").count == rank_by_pinocchio(model, 60) == 213


def test_what_is_no_pose_is_refused() -> None:
    """Quaternions that are none, a pitch that Euler angles do not have, no base, two bases."""
    tree, recording = humanoid(0.5, 100.0, 5, 0.0)
    free, base = with_free_base(tree), recording.measured("base").copy()
    with refuses(RecordingError, "w, x, y, z"):
        base_coordinates(base * 2)
    base[:, 3:] = [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]
    with refuses(RecordingError, "80"):
        base_coordinates(base)
    with refuses(RecordingError, "base"):
        tb.identify(free, replace(recording, base=None))
    with refuses(ModelError, "base.x"):
        with_free_base(free)
