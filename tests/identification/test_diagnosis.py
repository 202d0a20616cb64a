"""Wrong data say so; right data are left in peace."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from benchmarks.fault_trials import trials
from testbed.arrays import Array
from testbed.identification.cross_check import cross_check, findings_of, torque_factor
from testbed.identification.estimate import METHODS, Estimate, Method
from testbed.identification.finding import Finding, folded, in_lines
from testbed.identification.survey import Survey
from testbed.parameters.minimal_set import selection
from testbed.recordings.recording import Recording
from testbed.robot.inertia import NOTHING
from tests.helpers.measured import measured
from tests.helpers.paths import GOLDEN, ROOT

pytestmark = pytest.mark.slow

PUMA = ROOT / "models/puma562.xml"
ROBOTS = {
    name: GOLDEN / f"robots/{name}.urdf"
    for name in ("ur5", "gantry_ppp_rrr", "stanford", "scara_rrpr", "two_trunks", "kuka_lwr4")
} | {"puma": PUMA}


def both(tree: tb.Tree, recording: Recording, zeros: bool = True) -> dict[Method, Estimate]:
    return {m: tb.identify(tree, recording, m, zeros=zeros) for m in METHODS}


def found(estimates: dict[Method, Estimate]) -> list[Finding]:
    """All that is found in both methods' data and by holding them against each other."""
    alone = [each for estimate in estimates.values() for each in estimate.findings]
    return [*alone, *cross_check(estimates["external"], estimates["internal"])]


@pytest.fixture(scope="module")
def recording(puma: tb.Tree) -> Recording:
    return measured(puma)


@pytest.mark.parametrize(("duration", "told"), [(1.85, True), (6.0, False)])
def test_too_few_values_for_the_unknowns_are_told(duration: float, told: bool) -> None:
    """Their errors are many sigmas, whatever the noise: residuals of so few say nothing of it."""
    tree = tb.load_tree(ROBOTS["ur5"])
    estimate = tb.identify(tree, measured(tree, duration=duration), "external")
    codes = {each.code for each in estimate.findings}
    assert ("few-values" in codes) is told


# Right data.


@pytest.mark.parametrize("memory", [0.0, 0.98], ids=["white", "coloured"])
@pytest.mark.parametrize("robot", ROBOTS)
def test_nothing_is_found_in_clean_recordings(robot: str, memory: float) -> None:
    """With known zeros and without."""
    tree = tb.load_tree(ROBOTS[robot])
    for zeros in (False, True):
        assert found(both(tree, measured(tree, memory=memory), zeros)) == []


@pytest.mark.slow
@pytest.mark.parametrize("case", [{}, {"speed": 0.2}, {"noise": 10.0}, {"noise": 1e-9}], ids=str)
@pytest.mark.parametrize("robot", ROBOTS)
def test_nothing_is_found_in_unusual_clean_recordings(robot: str, case: dict[str, float]) -> None:
    """Slow motions, poor instruments, and perfect ones; `benchmarks detection` makes hundreds."""
    tree = tb.load_tree(ROBOTS[robot])
    assert found(both(tree, measured(tree, 1, **case))) == []


@pytest.mark.parametrize("robot", ["gantry_ppp_rrr", "scara_rrpr", "pendulum", "coaxial2"])
def test_channels_that_a_motion_leaves_at_rest_are_no_fault(robot: str) -> None:
    """Some forces of these robots are constant, and exactly so without noise."""
    tree = tb.load_tree(GOLDEN / f"robots/{robot}.urdf")
    assert found(both(tree, measured(tree, noise=0.0), zeros=False)) == []


def test_a_simulated_recording_is_left_in_peace(puma: tb.Tree, puma_recording: Recording) -> None:
    assert tb.identify(puma, puma_recording, zeros=True).findings == ()


# Wrong data.

TOLD = {
    "wrench and tare negated": "total mass is negative",
    "tare 0": "the tare's force is -?0 -?0 -?0 N",
    "wrench in lbf": "total mass is negative",
    "moments in N mm": "is of no rigid bodies|is explained poorly",
    "Fx of opposite sign": r"channel Fx .* the opposite sign \(it is -(1|0\.99)",
    "Fz of opposite sign": "total mass is negative",
    "Mx of opposite sign": r"channel Mx .* the opposite sign \(it is -(1|0\.99)",
    "Mz of opposite sign": "channel Mz is explained poorly|is of no rigid bodies",
    "Fy dead": "channel Fy is always 0 N",
    "My saturated at half": "channel My stays at its extreme value",
    "Fx and Fz exchanged": "total mass is negative",
    "Mx and My exchanged": "channel M[xy] is explained poorly",
    "plate turned 5 deg about x": "is explained poorly",
    "moment point off by 20 cm along x": "is explained poorly",
    "torques of opposite sign": "the friction coulomb/waist is negative",
    "torques in N mm": "reaches .* N mm instead of N m",
    "torque of elbow of opposite sign": "the friction coulomb/elbow is negative",
    "torque of elbow saturated at half": "the torque of 'elbow' stays at its extreme value",
    "torque of waist dead": "the torque of 'waist' is always 0 N m",
    "torques of shoulder and elbow exchanged": "is explained poorly",
    "encoders in degrees": "reads .* likely degrees instead of rad",
    "encoder of shoulder in degrees": "encoder of 'shoulder' reads .* likely degrees",
    "encoder of shoulder of opposite sign": "is of no rigid bodies|is explained poorly",
    "Moon's gravity": "is explained poorly",
    "gravity upwards": "total mass is negative",
}


@pytest.mark.parametrize("fault", TOLD)
def test_a_fault_is_told_with_its_cause(fault: str, puma: tb.Tree, recording: Recording) -> None:
    (trial, *_) = (each for each in trials(puma) if each.fault == fault)
    estimate = tb.identify(trial.tree, trial.change(recording), trial.method, zeros=True)
    said = "\n".join(estimate.warnings)
    assert any(re.search(TOLD[fault], line) for line in estimate.warnings), said
    assert estimate.findings
    assert all("\n" not in line for line in estimate.warnings)


@pytest.mark.parametrize("name", ["puma", "ur5", "gantry_ppp_rrr"])
@pytest.mark.parametrize("samples", [4, -4])
def test_joint_torques_that_are_late_are_told_without_a_plate(name: str, samples: int) -> None:
    """By 20 ms, or early: then the encoders are late."""
    tree = tb.load_tree(ROBOTS[name])
    whole = measured(tree, duration=60.0)
    part = slice(8, whole.samples - 8)
    torque = np.roll(whole.measured("torque"), samples, axis=0)[part]
    late = replace(whole.part(part.start, part.stop), torque=torque)
    estimate = tb.identify(tree, late, "internal")
    (line,) = (x for x in estimate.warnings if "the joint torques are" in x)
    way, cause = ("behind", "torques") if samples > 0 else ("ahead of", "encoders")
    assert f"are {way} the motion" in line
    assert f"likely {cause} that are late" in line
    sound = tb.identify(tree, whole, "internal")
    assert sound.findings == ()


SEEN = ("sign", "unit", "tare", "order", "channel", "gravity")
"""Kinds of faults that need no statistics of the residuals."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", SEEN)
def test_no_gross_fault_that_ruins_an_estimate_passes_in_silence(
    kind: str, puma: tb.Tree, recording: Recording
) -> None:
    """Of all trials of these kinds that make an error above 20 %."""
    ruined, silent = 0, []
    theta = tb.barycentric(puma)
    for trial in trials(puma):
        if trial.kind == kind:
            changed = trial.change(recording)
            estimate = tb.identify(trial.tree, changed, trial.method, zeros=True)
            truth = estimate.minimal.values(theta)
            if np.abs(estimate.base.values / truth - 1).max() > 0.2:
                ruined += 1
                if not estimate.findings and not found(both(trial.tree, changed)):
                    silent.append(trial.fault)
    assert ruined
    assert silent == []


def test_causes_are_named_once_for_all_that_share_them(puma: tb.Tree, recording: Recording) -> None:
    estimate = tb.identify(puma, _linear(recording, "torque", -1.0), "internal", zeros=True)
    negative = [each for each in estimate.findings if "negative" in each.found]
    assert len(negative) == 6
    (line,) = folded(negative)
    assert line in estimate.warnings
    assert line.count("likely") == 1
    for each in negative[:2]:
        assert f"{each.subject} {each.found}" in line
    assert "4 more" in line
    assert in_lines(negative[:1]) == [negative[0].text]


def _linear(recording: Recording, signal: str, factor: float) -> Recording:
    return replace(recording, **{signal: factor * recording.measured(signal)})  # type: ignore[arg-type]


def test_poorly_determined_parameters_fill_one_line(puma: tb.Tree) -> None:
    """The worst are named, the others counted."""
    noisy = measured(puma, noise=300.0, duration=10.0)
    (line,) = (w for w in tb.identify(puma, noisy).warnings if "poorly determined" in w)
    assert line.count("+-") == 6
    assert " more" in line


# The raw signals.


def test_encoders_outside_their_range_have_likely_causes(puma: tb.Tree) -> None:
    recording = measured(puma)
    cases: dict[str, Callable[[Array], Array]] = {
        "degrees instead of rad": np.rad2deg,
        "another zero": lambda q: q + np.array([0.0, 2.5, 0.0]),
    }
    for cause, change in cases.items():
        wrong = replace(recording, position=change(recording.position))
        first = tb.identify(puma, wrong, zeros=True).findings[0]
        assert first.causes[0] == cause
    joints = [replace(j, position_range=np.array([0.2, 3.0])) for j in puma.joints]
    flipped = replace(puma, joints=tuple(joints))
    forward = replace(recording, position=np.abs(recording.position) + 0.25)
    back = replace(forward, position=-forward.position)
    assert not _of_encoders(tb.identify(flipped, forward, zeros=True))
    assert _of_encoders(tb.identify(flipped, back, zeros=True))[0].causes[0] == "the opposite sign"


def _of_encoders(estimate: Estimate) -> list[Finding]:
    return [each for each in estimate.findings if "encoder of" in each.subject]


def test_a_joint_that_hardly_moves_is_named(puma: tb.Tree) -> None:
    recording = measured(puma, noise=1e-6)
    still = np.array([1.0, 1.0, 5e-3])
    (said,) = _of_encoders(
        tb.identify(puma, replace(recording, position=recording.position * still), zeros=True)
    )
    assert said.subject == "the encoder of 'elbow'"
    assert "moves by only" in said.found


def test_a_crest_is_no_stop(puma: tb.Tree, recording: Recording) -> None:
    """Twelve bits of a smooth signal pile up at its crests; a stop piles up ten times more."""
    quiet = measured(puma, noise=1e-9)
    wrench = quiet.measured("wrench")
    step = np.ptp(wrench, axis=0) / 4096
    coarse = replace(quiet, wrench=step * np.round(wrench / step))
    assert not [f for f in tb.identify(puma, coarse, zeros=True).findings if "extreme" in f.found]
    top = 0.9 * coarse.measured("wrench").max(axis=0)
    cut = replace(coarse, wrench=np.minimum(coarse.measured("wrench"), top))
    stops = [f.subject for f in tb.identify(puma, cut, zeros=True).findings if "extreme" in f.found]
    assert len(stops) >= 4


def test_a_survey_is_the_same_for_any_cut_and_any_number_of_threads(
    puma: tb.Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from testbed.identification import identify as module

    monkeypatch.setattr("testbed.identification.passes.SMALL", 0.0)
    recording = measured(puma, duration=400.0, noise=1e-3)
    recording.save(tmp_path / "recording.parquet")
    surveys: list[Survey] = []

    def keep(estimate: Estimate, tree: tb.Tree, survey: Survey, tare: Array) -> tuple[()]:
        surveys.append(survey)
        return ()

    monkeypatch.setattr(module, "findings", keep)
    cuts = (recording.part(k, min(k + 7777, 80_000)) for k in range(0, 80_000, 7777))
    for source, threads in ((recording, 1), (recording, 3), (tmp_path / "recording.parquet", 2)):
        tb.identify(puma, source, threads=threads)
    tb.identify(puma, cuts)
    one, *others = surveys
    stride, seen = 80_000 // 20_000, len(one.position)
    assert seen >= 20_000 - 5  # rows do not reach the last samples
    expected = recording.measured("wrench") - tb.pedestal_wrench(puma)
    np.testing.assert_array_equal(one.position, recording.position[::stride][:seen])
    np.testing.assert_array_equal(one.measured, expected[::stride][:seen])
    for other in others:
        np.testing.assert_array_equal(other.position, one.position)
        np.testing.assert_array_equal(other.measured, one.measured)
        np.testing.assert_array_equal(other.encoder_noise, one.encoder_noise)
    np.testing.assert_allclose(one.encoder_noise, 1e-7, rtol=0.1)


# The plate.


def test_a_tare_is_held_against_the_pedestal(puma: tb.Tree, recording: Recording) -> None:
    assert recording.tare is not None
    for factor, told in ((1.0, False), (1.3, False), (0.7, False), (0.2, True), (-1.0, True)):
        wrong = replace(recording, tare=factor * recording.tare)
        said = [f for f in tb.identify(puma, wrong, zeros=True).findings if "tare" in f.subject]
        assert bool(said) == told
    bolted = replace(puma, pedestal=NOTHING)
    fresh = measured(bolted)
    heavy = replace(fresh, tare=np.array([0, 0, 50.0, 0, 0, 0]), wrench=_loaded(fresh))
    assert tb.identify(bolted, heavy).findings == ()


def _loaded(recording: Recording) -> Array:
    loaded: Array = recording.measured("wrench") + np.array([0, 0, 50.0, 0, 0, 0])
    return loaded


def test_weightlessness_has_no_weight(puma: tb.Tree) -> None:
    free = puma.with_gravity([0.0, 0.0, 0.0])
    assert tb.identify(free, measured(free)).findings == ()


# Both methods.


@pytest.mark.parametrize("factor", [1.1, 0.92])
def test_torque_constants_that_are_off_a_little_are_said_in_one_line(
    factor: float, puma: tb.Tree, recording: Recording
) -> None:
    """The estimate from torques is off by as much, with a small sigma."""
    found = findings_of(both(puma, _linear(recording, "torque", factor)).values())
    told = [each for each in found if each.code == "torque-constant"]
    assert len(told) == 3
    assert all(each.support > 8 for each in told)
    assert len(folded(told)) == 1
    assert folded(found)[0] == folded(told)[0] or len(folded(found)[0]) > len(folded(told)[0])


def test_one_torque_constant_is_said_with_its_joint(puma: tb.Tree, recording: Recording) -> None:
    gain = np.array([1.0, 1.05, 1.0])
    wrong = replace(recording, torque=recording.measured("torque") * gain)
    (one,) = cross_check(*both(puma, wrong).values())
    assert one.subject == "the torque of 'shoulder'"
    assert one.number == pytest.approx(1.05, abs=5e-3)


def test_a_plate_at_fault_is_no_judge_of_drives(puma: tb.Tree, recording: Recording) -> None:
    """Its own warning comes first: an encoder's scale is in both estimates."""
    scale = np.array([1.0, 1.0, 1.01])
    estimates = both(puma, replace(recording, position=recording.position * scale))
    assert estimates["external"].findings
    assert cross_check(*estimates.values()) == ()


@pytest.mark.parametrize("size", [0.0, 0.015])
def test_sound_drives_are_left_in_peace(size: float, puma: tb.Tree, recording: Recording) -> None:
    wrong = replace(recording, torque=recording.measured("torque") * (1 + size))
    assert findings_of(both(puma, wrong).values()) == []


@pytest.mark.parametrize(
    ("signal", "factor", "cause"),
    [
        ("torque", -1.0, "the opposite sign of torque, encoder or wrench"),
        ("torque", 1e3, "torques in N mm"),
        ("torque", 0.7376, "torques in lbf ft"),
        ("torque", 1 / 53.7, "torques on the motor's side of the gear"),
    ],
)
def test_a_factor_between_the_methods_names_the_unit(
    signal: str, factor: float, cause: str, puma: tb.Tree, recording: Recording
) -> None:
    found = cross_check(*both(puma, _linear(recording, signal, factor)).values())
    assert [each.code for each in found] == ["torque-scale"] * 3
    assert {each.causes[0] for each in found} == {cause}


@pytest.mark.parametrize("robot", ["puma", "ur5", "gantry_ppp_rrr"])
def test_the_factor_is_the_torque_constant_whatever_rubs(robot: str) -> None:
    """Friction, offsets and rotors, asked for or hidden in a body's inertia."""
    tree = tb.load_tree(ROBOTS[robot])
    joints = [replace(j, coulomb=3.0, viscous=2.0, rotor_inertia=0.5) for j in tree.joints]
    geared = replace(tree, joints=tuple(joints))
    gain = np.linspace(0.5, 2.0, tree.n)
    recording = measured(geared, duration=60.0)
    wrong = replace(recording, torque=gain * recording.measured("torque") + 2.0)
    settings = tb.Settings(terms=("coulomb", "viscous", "offset", "rotor"))
    external, internal = (tb.identify(geared, wrong, m, settings=settings) for m in METHODS)
    s = selection(internal.minimal, external.minimal)
    known, spread = s @ external.base.values, s @ external.base.covariance @ s.T
    factors = [torque_factor(internal, known, spread, j) for j in range(tree.n)]
    clear = [j for j, factor in enumerate(factors) if factor is not None]
    assert len(clear) >= 2
    for j in clear:
        found = factors[j]
        assert found is not None
        assert found.value == pytest.approx(gain[j], rel=0.02)
        assert abs(found.value - gain[j]) < 4 * found.sigma + 1e-3 * gain[j]


def test_one_method_alone_has_nothing_to_be_held_against(
    puma: tb.Tree, recording: Recording
) -> None:
    estimates = both(puma, recording)
    for estimate in estimates.values():
        assert findings_of([estimate]) == list(estimate.findings)
    other = tb.identify(puma, recording, "internal", gravity=[0, 0, -1.62])
    assert cross_check(estimates["external"], other) == ()


@pytest.mark.parametrize("size", [2.0, 20.0])
def test_a_drift_that_only_the_total_mass_feels_is_said(puma: tb.Tree, size: float) -> None:
    """No constant of Fz can be told from the mass: that it wanders can."""
    recording = measured(puma)
    drift = np.zeros((recording.samples, 6))
    drift[:, 2] = np.linspace(0, size, recording.samples)
    drifting = replace(recording, wrench=recording.measured("wrench") + drift)
    said = tb.identify(puma, drifting).warnings
    assert any("the plate's zero drifts" in line and "Fz" in line for line in said)
    assert not any("drifts" in line for line in tb.identify(puma, recording).warnings)
