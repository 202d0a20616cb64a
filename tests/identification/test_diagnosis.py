"""Wrong data say so, with their cause first; right data are left in peace."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from string import Formatter

import numpy as np
import pytest

import testbed as tb
from benchmarks.fault_trials import trials
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import (
    cause_phrase,
    diagnostics_from_json,
    message_table,
    ordered_diagnostics,
)
from testbed.core.estimation.diagnostics.torques import (
    diagnostics_of_estimates,
    torque_factor,
    torque_scale_diagnostics,
)
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.rules import SIGNALS
from testbed.core.recordings.recording import Recording
from tests.helpers.ideal import plus
from tests.helpers.measured import measured
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.refusals import is_message
from tests.helpers.runs import robot

pytestmark = pytest.mark.slow

TOLD = {
    "tare 0": "plate.tare of the tare's force",
    "moments in N mm": "estimate.impossible of the wrench estimate",
    "Fz of opposite sign": "plate.negative-mass of the robot's total mass",
    "Mz of opposite sign": "channel.residual of channel Mz",
    "Fy dead": "channel.constant of channel Fy",
    "My saturated at half": "channel.saturated of channel My",
    "torques of opposite sign": "friction.negative of the friction coulomb/waist",
    "torques in N mm": "torque.effort of the torque of 'waist'",
    "torques of shoulder and elbow exchanged": "channel.residual of the torque of 'elbow'",
    "encoders in degrees": "encoder.range of the encoder of 'waist'",
}
"""What must be among the diagnostics of a gross fault; `benchmarks faults` has them all."""


def both(tree: tb.Tree, recording: Recording, zeros: bool = True) -> list[Estimate]:
    return [tb.identify(tree, recording, m, zeros=zeros) for m in SIGNALS]


def errors_of(estimates: list[Estimate]) -> list[str]:
    return [each.code for each in diagnostics_of_estimates(estimates) if each.level == "error"]


@pytest.fixture(scope="module")
def recording(puma: tb.Tree) -> Recording:
    return measured(puma)


@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_nothing_is_found_in_clean_recordings(name: str) -> None:
    """White and coloured noise, slow motions, poor and perfect instruments, no gravity."""
    tree = robot(name)
    for case in ({}, {"memory": 0.98}, {"speed": 0.2}, {"noise": 10.0}, {"noise": 0.0}):
        assert errors_of(both(tree, measured(tree, 1, **case))) == []
    free = tree.with_gravity([0.0, 0.0, 0.0])
    assert not tb.identify(free, measured(free)).has_errors
    pendulum = tb.load_tree(GOLDEN / "robots/pendulum.urdf")  # forces that are constant
    assert errors_of(both(pendulum, measured(pendulum, noise=0.0), zeros=False)) == []


def test_a_gross_fault_is_told_with_its_subject(puma: tb.Tree, recording: Recording) -> None:
    made = {trial.fault: trial for trial in list(trials(puma))[::-1]}
    missed: dict[str, list[str]] = {}
    for fault, told in TOLD.items():
        trial = made[fault]
        found = tb.identify(trial.tree, trial.change(recording), trial.method, zeros=True)
        said = [f"{each.code} of {each.subject}" for each in found.diagnostics]
        missed |= {fault: said} if told not in said else {}
        assert all(is_message(line[:300]) for line in map(str, found.diagnostics))
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
        (puma, replace(quiet, wrench=coarse), "channel.saturated", 0, ""),
        (puma, replace(quiet, wrench=stopped), "channel.saturated", 4, ""),
        (puma, replace(recording, tare=1.3 * tare), "plate.tare", 0, ""),
        (puma, replace(recording, tare=0.7 * tare), "plate.tare", 0, ""),
        (puma, replace(recording, tare=0.2 * tare), "plate.tare", 1, ""),
        (puma, replace(recording, tare=-tare), "plate.tare", 1, "sign"),
        (limited, replace(recording, position=forward), "encoder.range", 0, ""),
        (limited, replace(recording, position=-forward), "encoder.range", 1, "sign"),
        (puma, replace(recording, position=np.rad2deg(position)), "encoder.range", 1, "degrees"),
        (puma, replace(recording, position=off), "encoder.range", 1, "zero"),
        (puma, replace(recording, position=still), "encoder.still", 1, ""),
        (robot("ur5"), measured(robot("ur5"), duration=1.85), "estimate.few-values", 1, ""),
        (robot("ur5"), measured(robot("ur5"), duration=6.0), "estimate.few-values", 0, ""),
    )
    for tree, given, code, least, cause in cases:
        found = tb.identify(tree, given, zeros=True).diagnostics
        causes = [each.causes[0] for each in found if each.code == code]
        assert len(causes) >= least
        assert not causes or least
        assert cause in (causes or [""])[0]


def test_a_wrong_zero_of_one_encoder_is_named_with_its_size(puma: tb.Tree) -> None:
    """The joint and its offset; the remedy finds it, and leaves less.

    Of a last joint none shows: its body's parameters turn with it, and predict the same.
    """
    full = measured(puma, 3, duration=30.0)
    for joint, name in enumerate(puma.names[1:], start=1):
        off = 0.03 * np.eye(3)[joint]
        given = replace(full, position=full.position + off)
        found = tb.identify(puma, given)
        if joint == 2:
            assert found.model_errors == ()
            continue
        (error,) = found.model_errors
        one = error.coefficients[0]
        assert (error.family, one.name) == ("joint_zeros", f"joint_zeros/{name}")
        assert abs(one.value - 0.03) < 4 * one.sigma
        assert any(name in each.text for each in found.diagnostics)
        settings = tb.Settings(nuisances=["joint_zeros"])
        estimated = tb.identify(puma, given, settings=settings)
        (own,) = (each for each in estimated.nuisances if each.name == one.name)
        assert abs(own.value - 0.03) < 4 * own.sigma < 0.03
        assert estimated.model_errors == ()


def test_a_drift_that_only_the_mass_feels_is_said(puma: tb.Tree, recording: Recording) -> None:
    """No constant of Fz can be told from the mass: that it wanders can."""
    assert tb.identify(puma, recording).diagnostics == ()
    for size in (2.0, 20.0):
        drift = np.linspace(0, size, recording.samples)[:, None] * np.eye(6)[2]
        found = tb.identify(puma, plus(recording, wrench=drift)).diagnostics
        assert sum("Fz" in d.text and d.code in ("plate.drift", "plate.offset") for d in found) == 1


def test_late_torques_are_told_from_early_ones_without_a_plate() -> None:
    """By 20 ms; of early ones the delays are negative."""
    tree = robot("gantry")
    whole = measured(tree, duration=60.0)
    assert not tb.identify(tree, whole, "torque").has_errors
    for samples in (4, -4):
        torque = np.roll(whole.measured("torque"), samples, axis=0)
        late = replace(whole, torque=torque).part(8, whole.samples - 8)
        (error,) = tb.identify(tree, late, "torque").model_errors
        assert error.family == "torque_lag"
        delays = [each for each in error.coefficients if abs(each.value) > 6 * each.sigma]
        assert len(delays) > 2
        assert all(0 < each.value * np.sign(samples) < 0.03 for each in delays)


# Both methods.


def scaled(recording: Recording, factor: Array | float) -> Recording:
    return replace(recording, torque=factor * recording.measured("torque"))


def test_factors_between_methods_are_told_with_causes(puma: tb.Tree, recording: Recording) -> None:
    """Constants that are off a little, units, signs; 1.5 % is left in peace."""
    seen = []
    for factor in (1.015, 1.1, 0.92, -1.0, 1e3, 0.7376, 1 / 53.7):
        found = [*torque_scale_diagnostics(*both(puma, scaled(recording, factor)))]
        assert len(found) == 3 * (factor != 1.015)
        assert all(each.value == pytest.approx(factor, rel=0.02) for each in found)
        near = 0.8 < factor < 1.2
        assert {each.code for each in found} <= {"torque.constant" if near else "torque.scale"}
        if near:
            assert all((each.significance or 0) > 8 for each in found)
            assert len(tb.sentences(ordered_diagnostics(found))) <= 1
        else:
            seen.append({each.causes[0] for each in found})
    assert [len(causes) for causes in seen] == [1, 1, 1, 1]
    assert len(set.union(*seen)) == 4  # sign, N mm, lbf ft, the gear
    other = tb.identify(puma, recording, "torque", gravity=[0, 0, -1])
    assert not [*torque_scale_diagnostics(tb.identify(puma, recording, zeros=True), other)]


@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_the_factor_is_the_torque_constant_whatever_rubs(name: str) -> None:
    """Friction, offsets and rotors, asked for or hidden in a body's inertia."""
    tree = robot(name)
    own = {"coulomb": 3.0, "viscous": 2.0, "rotor_inertia": 0.5}
    geared = tree.with_joints(dict.fromkeys(tree.names, own))
    gain = np.linspace(0.5, 2.0, tree.n)
    wrong = plus(scaled(measured(geared, duration=60.0), gain), torque=2.0)
    settings = tb.Settings(terms=("coulomb", "viscous", "offset", "rotor"))
    external, internal = (tb.identify(geared, wrong, m, settings=settings) for m in SIGNALS)
    s = tb.selection(internal.minimal, external.minimal)
    known, spread = s @ external.base.values, s @ external.base.covariance @ s.T
    factors = [torque_factor(internal, known, spread, j) for j in range(tree.n)]
    assert sum(factor is not None for factor in factors) >= 2
    for own, factor in zip(gain, factors, strict=True):
        if factor is not None:
            assert factor.value == pytest.approx(own, rel=0.02)
            assert abs(factor.value - own) < 4 * factor.sigma + 1e-3 * own


# As a person reads them.


def a_case(code: str, method: str = "", significance: float | None = None) -> tb.Diagnostic:
    """Of a code, with causes and remedy of its own."""
    return tb.Diagnostic(
        code, f"{code} {method}", "error", code, 1.0, None, significance, method, (code,), "look"
    )


CONSTANT = a_case("torque.constant", "torque", 90.0)
CLOCK = a_case("plate.skew", "wrench", 30.0)
ENCODER = a_case("encoder.range")


def test_one_cause_comes_first_with_what_follows_from_it() -> None:
    """Of its own method; a small fault explains no gross residual; the clearest first."""
    bodies, other, error, residual = (
        a_case("estimate.impossible", "wrench"),
        a_case("estimate.impossible", "torque"),
        a_case("estimate.bias", "torque"),
        a_case("channel.residual", "wrench"),
    )
    note = tb.Diagnostic("note", "what else is known", "info")
    for given, wanted, follows in (
        ([], [], 0),
        ([note, other, CONSTANT, error], [CONSTANT, note], 2),
        ([CLOCK, CONSTANT, ENCODER, bodies, other], [ENCODER, CONSTANT, CLOCK], 2),
        ([CONSTANT, bodies], [bodies, CONSTANT], 0),
        ([CLOCK, residual], [residual, CLOCK], 0),
        ([ENCODER, residual], [ENCODER], 1),
        ([error, other], [other], 1),
    ):
        found = ordered_diagnostics(given)
        assert [each for each in found if not each.follows] == wanted
        assert sum(bool(each.follows) for each in found) == follows
        assert ordered_diagnostics(found) == found
        lines = tb.sentences(found)
        assert [line.startswith(d.text) for line, d in zip(lines, wanted, strict=True)] == [
            True for _ in wanted
        ]
        symptoms = {message_table()[each.code].symptom for each in found if each.follows}
        assert all(any(symptom in line for line in lines) for symptom in symptoms)
        assert diagnostics_from_json(json.loads(json.dumps([d.as_dict() for d in found]))) == found
    several = [replace(ENCODER, text=f"joint {k}") for k in range(5)]
    (line,) = tb.sentences(ordered_diagnostics(several))
    assert "3 similar" in line


def test_every_sentence_has_its_numbers() -> None:
    """What the calls of the whole house give is what the table's sentences hold."""
    for path in (ROOT / "testbed").rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text())):
            if not isinstance(call, ast.Call) or getattr(call.func, "id", "") != "diagnose":
                continue
            given = {each.arg for each in call.keywords} | {"subject", "method"}
            given |= {"value"} if len(call.args) > 2 else set()
            more = {each.arg for each in call.keywords if each.arg is None}
            codes, lacking = codes_in(call.args[0]), []
            for code in codes:
                message = message_table()[code]
                texts = [message.text, message.remedy, *message.optional.values()]
                fields = (f[1] for text in texts for f in Formatter().parse(text) if f[1])
                needed = {name.partition("[")[0] for name in fields} | message.optional.keys()
                lacking += [] if more or needed <= given else [(code, needed - given)]
                causes = [*message.causes, *named(call)]
                assert [cause for cause in causes if cause_phrase(cause) == cause] == [], code
            # of a code that is put together some sentences fit, those of other calls need not
            computed = isinstance(call.args[0], ast.JoinedStr)
            assert not lacking or (computed and len(lacking) < len(codes)), (path, lacking)


def named(call: ast.Call) -> list[str]:
    """Causes that a call names."""
    causes = [each.value for each in call.keywords if each.arg == "causes"]
    texts = (n.value for each in causes for n in ast.walk(each) if isinstance(n, ast.Constant))
    return [text for text in texts if isinstance(text, str) and text.strip() == text]


def codes_in(code: ast.expr) -> list[str]:
    """Codes that an expression may be."""
    if isinstance(code, ast.IfExp):
        return [*codes_in(code.body), *codes_in(code.orelse)]
    if isinstance(code, ast.Constant):
        return [str(code.value)]
    assert isinstance(code, ast.JoinedStr), ast.dump(code)
    start = code.values[0].value if isinstance(code.values[0], ast.Constant) else ""
    return [known for known in message_table() if known.startswith(str(start))]
