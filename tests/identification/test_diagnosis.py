"""Wrong data say so, with their cause first; right data are left in peace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from benchmarks.fault_trials import trials
from testbed.arrays import Array
from testbed.identification.cross_check import cross_check, findings_of, torque_factor
from testbed.identification.estimate import METHODS, Estimate
from testbed.identification.finding import SYMPTOMS, Finding, folded
from testbed.parameters.minimal_set import selection
from testbed.recordings.recording import Recording
from tests.helpers.ideal import plus
from tests.helpers.measured import measured
from tests.helpers.paths import GOLDEN
from tests.helpers.refusals import is_message
from tests.helpers.runs import robot

pytestmark = pytest.mark.slow

TOLD = {
    "tare 0": "tare of the tare's force",
    "moments in N mm": "no-rigid-bodies of the external estimate",
    "Fz of opposite sign": "negative-mass of the robot's total mass",
    "Mz of opposite sign": "residual of channel Mz",
    "Fy dead": "constant-channel of channel Fy",
    "My saturated at half": "saturation of channel My",
    "torques of opposite sign": "negative-friction of the friction coulomb/waist",
    "torques in N mm": "effort of the torque of 'waist'",
    "torques of shoulder and elbow exchanged": "residual of the torque of 'elbow'",
    "encoders in degrees": "encoder-range of the encoder of 'waist'",
}
"""What must be among the findings of a gross fault; `python -m benchmarks faults` has them all."""


def both(tree: tb.Tree, recording: Recording, zeros: bool = True) -> list[Estimate]:
    return [tb.identify(tree, recording, m, zeros=zeros) for m in METHODS]


@pytest.fixture(scope="module")
def recording(puma: tb.Tree) -> Recording:
    return measured(puma)


@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_nothing_is_found_in_clean_recordings(name: str) -> None:
    """White and coloured noise, slow motions, poor and perfect instruments, no gravity."""
    tree = robot(name)
    for case in ({}, {"memory": 0.98}, {"speed": 0.2}, {"noise": 10.0}, {"noise": 0.0}):
        assert findings_of(both(tree, measured(tree, 1, **case))) == []
    free = tree.with_gravity([0.0, 0.0, 0.0])
    assert tb.identify(free, measured(free)).findings == ()
    pendulum = tb.load_tree(GOLDEN / "robots/pendulum.urdf")  # forces that are constant
    assert findings_of(both(pendulum, measured(pendulum, noise=0.0), zeros=False)) == []


def test_a_gross_fault_is_told_with_its_subject(puma: tb.Tree, recording: Recording) -> None:
    made = {trial.fault: trial for trial in list(trials(puma))[::-1]}
    missed: dict[str, list[str]] = {}
    for fault, told in TOLD.items():
        trial = made[fault]
        found = tb.identify(trial.tree, trial.change(recording), trial.method, zeros=True)
        said = [f"{each.code} of {each.subject}" for each in found.findings]
        missed |= {fault: said} if told not in said else {}
        assert all(is_message(line[:300]) for line in found.warnings)
    assert missed == {}


def test_a_fault_is_told_from_what_is_near_to_it(puma: tb.Tree, recording: Recording) -> None:
    """A crest is no stop, a poor tare no wrong one, early torques are late encoders.

    Twelve bits of a smooth signal pile up at its crests; a stop piles up ten times more. Of few
    values residuals say nothing. Units, signs and zeros of encoders have different words.
    """
    quiet, position = measured(puma, noise=1e-9), recording.position
    step = np.ptp(quiet.measured("wrench"), axis=0) / 4096
    coarse = step * np.round(quiet.measured("wrench") / step)
    stopped = np.minimum(coarse, 0.9 * coarse.max(axis=0))
    limited = puma.with_joints({n: {"position_range": np.array([0.2, 3.0])} for n in puma.names})
    forward, tare = np.abs(position) + 0.25, tb.pedestal_wrench(puma)
    still, off = position * [1.0, 1.0, 5e-3], position + np.array([0.0, 2.5, 0.0])
    cases: tuple[tuple[tb.Tree, Recording, str, int, str], ...] = (
        (puma, replace(quiet, wrench=coarse), "saturation", 0, ""),
        (puma, replace(quiet, wrench=stopped), "saturation", 4, ""),
        (puma, replace(recording, tare=1.3 * tare), "tare", 0, ""),
        (puma, replace(recording, tare=0.7 * tare), "tare", 0, ""),
        (puma, replace(recording, tare=0.2 * tare), "tare", 1, ""),
        (puma, replace(recording, tare=-tare), "tare", 1, "sign"),
        (limited, replace(recording, position=forward), "encoder-range", 0, ""),
        (limited, replace(recording, position=-forward), "encoder-range", 1, "sign"),
        (puma, replace(recording, position=np.rad2deg(position)), "encoder-range", 1, "degrees"),
        (puma, replace(recording, position=off), "encoder-range", 1, "zero"),
        (puma, replace(recording, position=still), "joint-at-rest", 1, ""),
        (robot("ur5"), measured(robot("ur5"), duration=1.85), "few-values", 1, ""),
        (robot("ur5"), measured(robot("ur5"), duration=6.0), "few-values", 0, ""),
    )
    for tree, given, code, least, cause in cases:
        found = tb.identify(tree, given, zeros=True).findings
        causes = [each.causes[0] for each in found if each.code == code]
        assert len(causes) >= least
        assert not causes or least
        assert cause in (causes or [""])[0]


def test_a_drift_that_only_the_total_mass_feels_is_said(
    puma: tb.Tree, recording: Recording
) -> None:
    """No constant of Fz can be told from the mass: that it wanders can."""
    assert tb.identify(puma, recording).warnings == ()
    for size in (2.0, 20.0):
        drift = np.linspace(0, size, recording.samples)[:, None] * np.eye(6)[2]
        lines = tb.identify(puma, plus(recording, wrench=drift)).warnings
        assert sum("Fz" in line and "drift" in line for line in lines) == 1


def test_late_torques_are_told_from_early_ones_without_a_plate() -> None:
    """By 20 ms; early ones are late encoders."""
    tree = robot("gantry")
    whole = measured(tree, duration=60.0)
    assert tb.identify(tree, whole, "internal").findings == ()
    for samples, cause in ((4, "torques"), (-4, "encoders")):
        torque = np.roll(whole.measured("torque"), samples, axis=0)
        late = replace(whole, torque=torque).part(8, whole.samples - 8)
        found = tb.identify(tree, late, "internal").findings
        (told,) = (each for each in found if each.code == "late-torques")
        assert 0 < told.number * np.sign(samples) <= 0.02
        assert cause in told.causes[0]


# Both methods.


def scaled(recording: Recording, factor: Array | float) -> Recording:
    return replace(recording, torque=factor * recording.measured("torque"))


def test_factors_between_the_methods_are_told_and_what_they_mean(
    puma: tb.Tree, recording: Recording
) -> None:
    """Constants that are off a little, units, signs; 1.5 % is left in peace."""
    seen = []
    for factor in (1.015, 1.1, 0.92, -1.0, 1e3, 0.7376, 1 / 53.7):
        found = cross_check(*both(puma, scaled(recording, factor)))
        assert len(found) == 3 * (factor != 1.015)
        assert all(each.number == pytest.approx(factor, rel=0.02) for each in found)
        near = 0.8 < factor < 1.2
        assert {each.code for each in found} <= {"torque-constant" if near else "torque-scale"}
        if near:
            assert all(each.support > 8 for each in found)
            assert len(folded(found)) <= 1
        else:
            seen.append({each.causes[0] for each in found})
    assert [len(causes) for causes in seen] == [1, 1, 1, 1]
    assert len(set.union(*seen)) == 4  # sign, N mm, lbf ft, the gear
    other = tb.identify(puma, recording, "internal", gravity=[0, 0, -1])
    assert cross_check(tb.identify(puma, recording, zeros=True), other) == ()


@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_the_factor_is_the_torque_constant_whatever_rubs(name: str) -> None:
    """Friction, offsets and rotors, asked for or hidden in a body's inertia."""
    tree = robot(name)
    own = {"coulomb": 3.0, "viscous": 2.0, "rotor_inertia": 0.5}
    geared = tree.with_joints(dict.fromkeys(tree.names, own))
    gain = np.linspace(0.5, 2.0, tree.n)
    wrong = plus(scaled(measured(geared, duration=60.0), gain), torque=2.0)
    settings = tb.Settings(terms=("coulomb", "viscous", "offset", "rotor"))
    external, internal = (tb.identify(geared, wrong, m, settings=settings) for m in METHODS)
    s = selection(internal.minimal, external.minimal)
    known, spread = s @ external.base.values, s @ external.base.covariance @ s.T
    factors = [torque_factor(internal, known, spread, j) for j in range(tree.n)]
    assert sum(factor is not None for factor in factors) >= 2
    for own, factor in zip(gain, factors, strict=True):
        if factor is not None:
            assert factor.value == pytest.approx(own, rel=0.02)
            assert abs(factor.value - own) < 4 * factor.sigma + 1e-3 * own


# As a person reads them.

CONSTANT = Finding("A", "is off", 1.05, ("a",), "mend", "torque-constant", "internal", 90.0)
CLOCK = Finding("B", "is late", 2.0, ("b",), "set", "fault-skew", "external", 30.0)
ENCODER = Finding("C", "is in degrees", 1.0, ("c",), "convert", "encoder-range")


def test_one_cause_comes_first_with_what_follows_from_it() -> None:
    """Of its own method; a small fault explains no gross residual; the clearest first."""
    bodies, other, error, residual = (
        Finding(f"{method} {code}", "is odd", 1.0, ("anything",), "look", code, method)
        for code, method in (
            ("no-rigid-bodies", "external"),
            ("no-rigid-bodies", "internal"),
            ("systematic-error", "internal"),
            ("residual", "external"),
        )
    )
    for given, wanted in (
        ([], []),
        ([other, CONSTANT, error], ["A"]),
        ([CLOCK, CONSTANT, ENCODER, bodies, other], ["C", "A", "B"]),
        ([CONSTANT, bodies], ["external", "A"]),
        ([CLOCK, residual], ["external", "B"]),
        ([ENCODER, residual], ["C"]),
        ([error, other], ["internal"]),
    ):
        assert [line.split()[0] for line in folded(given)] == wanted
    for given, told in (([other, CONSTANT, error], [True]), ([CONSTANT, bodies], [False, False])):
        assert [SYMPTOMS["no-rigid-bodies"] in line for line in folded(given)] == told
    assert "anything" not in folded([other, CONSTANT, error])[0]
    assert folded([error, other])[0].startswith(other.subject)
