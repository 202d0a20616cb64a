"""Torques of motors: rotors, offsets that drift, friction over temperature, velocity and load."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.applications.drives.friction_files import bam_parameters, write_friction
from testbed.applications.drives.identify_drives import DriveFindings, identify_drives
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.estimation.regression.windows import drive_filter
from testbed.core.recordings.recording import Recording
from testbed.core.robot.friction import SLOPE, VARYING, WARM_VISCOUS, joint_law
from tests.helpers.foreign_files import imported
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.measured import measured
from tests.helpers.refusals import refuses
from tests.helpers.runs import robot


def warming(whole: Recording, slope: float, warm: float) -> Recording:
    """With drives that warm up by 20 K, offsets that drift and viscous friction that changes."""
    time, speed = whole.time[:, None], whole.measured("velocity")
    temperature = 45.0 - 20.0 * np.exp(-time / time[-1]) * np.ones_like(speed)
    drift = slope * (time - whole.samples / whole.rate / 2)
    return plus(
        replace(whole, temperature=temperature),
        torque=drift + warm * (temperature - 25.0) * speed,
    )


def test_drift_and_temperature_are_terms_like_the_others(puma: tb.Tree, tmp_path: Path) -> None:
    """From memory, a file and parts; of another recording, whose drift is its own, friction is."""
    recording = warming(ideal(puma), 0.03, -0.05)
    asked = replace(EXACT, terms=("coulomb", "viscous", "offset", SLOPE.kind, WARM_VISCOUS.kind))
    recording.save(tmp_path / "warm.parquet")
    parts = [recording.part(0, 700), recording.part(700, recording.samples)]
    for source in (recording, tmp_path / "warm.parquet", parts):
        found = tb.identify(puma, source, "internal", settings=asked)
        values = dict(zip(found.names, found.values.tolist(), strict=True))
        for name in puma.names:
            assert values[f"slope/{name}"] == pytest.approx(0.03, abs=1e-8)
            assert values[f"warm_viscous/{name}"] == pytest.approx(-0.05, abs=1e-8)
    other = warming(ideal(puma, seed=1), 0.0, -0.05)
    assert (tb.validate(found, other).residual < 1e-7).all()
    with refuses(RecordingError, "temperature"):
        tb.identify(puma, ideal(puma), "internal", settings=asked)


@pytest.mark.parametrize(
    ("size", "expected"), [(0.0, set[str]()), (1.0, {"slope/elbow", "warm_viscous/elbow"})]
)
def test_drift_and_temperature_are_chosen_where_they_explain_data(
    size: float, expected: set[str], puma: tb.Tree
) -> None:
    """By data that no fit has seen; of steady drives neither is."""
    kinds = {law.kind for law in VARYING}
    for seed in range(2):
        whole = measured(puma, seed, duration=40.0)
        speed = np.gradient(whole.position, whole.time, axis=0)
        temperature = 25.0 + 20.0 * (1 - np.exp(-whole.time / 15.0))
        own = 0.05 * (whole.time - 20.0) - 0.05 * (temperature - 25.0) * speed[:, 2]
        recording = plus(whole, torque=size * own[:, None] * [0.0, 0.0, 1.0])
        recording = replace(recording, temperature=np.tile(temperature[:, None], 3))
        found = tb.identify(puma, recording, "internal", settings=tb.Settings(terms="auto"))
        assert found.drives is not None
        chosen = [term for term in found.drives.asked if term.law.kind in kinds]
        assert {term.name(puma) for term in chosen} == expected


LOG = """
rate = 100
joints = ["a", "b"]
[sources.log]
file = "log.csv"
rate = 100
[torque]
source = "log"
columns = ["A", "B"]
{}
[temperature]
source = "log"
columns = ["A", "B"]
unit = "degC"
[position]
source = "log"
columns = ["a", "b"]
unit = "rad"
{}
"""


@pytest.mark.parametrize(
    ("torque", "more", "kind"),
    [
        ('unit = "A"\ngain = 3', "", "current"),
        ('unit = "pwm"\ngain = 3', "", "pwm"),
        ('unit = "V"\ngain = 3', "", "torque"),
        ('unit = "N m"', "", "torque"),
        ('unit = "N m"\nside = "motor"', 'side = "motor"\n[gear]\nratio = [50, 50]', "motor"),
    ],
)
def test_what_motors_give_moves_rotors(torque: str, more: str, kind: str, tmp_path: Path) -> None:
    """Of currents, voltages and the motors' side of gears; a sensor at the joint has none."""
    q = np.sin(np.arange(2000)[:, None] * [0.01, 0.017])
    table = np.column_stack([q, np.cos(q)])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="a,b,A,B", comments="")
    recording = imported(tmp_path, LOG.format(torque, more))
    assert recording.facts["effort"] == {"a": kind, "b": kind}
    np.testing.assert_allclose(recording.measured("temperature"), np.cos(q), atol=1e-12)


def test_rotors_are_the_cause_of_torques_that_lead_no_longer_beside_them() -> None:
    tree = robot("ur5")
    joints = tuple(replace(j, rotor_inertia=0.3, coulomb=8.0, viscous=8.0) for j in tree.joints)
    geared = measured(replace(tree, joints=joints), duration=60.0)
    found = tb.identify(tree, geared, "internal").diagnostics
    (told,) = (said for said in found if said.code == "torque.delay")
    assert told.causes[0] == "rotor"
    motors = replace(geared, facts={"effort": dict.fromkeys(tree.names, "current")})
    right = tb.identify(tree, motors, "internal")
    assert "rotor/j6" in right.names
    assert not right.doubtful


# friction over velocity and load

CONSTANTS = np.array([1.05, 0.95, 1.05])
LOADED = ("load", "viscous_load", "driving_load", "quadratic_load")
LOSS = np.array([[0.05, 0.1, 0.2], [0.01, 0.002, 0.03], [0.004, 0.003, 0.002], [1e-3, 2e-3, 4e-3]])
"""Of those laws, by joint."""


def rubbing_puma() -> tb.Tree:
    """With friction of its own, which no rotor hides."""
    joints = {
        name: {"coulomb": 3.0 + k, "viscous": 2.0 + k} for k, name in enumerate(robot("puma").names)
    }
    return robot("puma").with_joints(joints)


def loads(tree: tb.Tree, recording: Recording) -> Array:
    """The torques that move the links, (M, n), by Newton and Euler."""
    true = recording.truth
    assert true is not None
    return tb.joint_forces(
        tree, tb.Motion(recording.time, true.position, true.velocity, true.acceleration)
    )


def rubbing(tree: tb.Tree, seconds: float, loss: Array = LOSS, noise: float = 0.0) -> Recording:
    """By drives whose gears take more under load, with constants that are off."""
    recording = ideal(tree, seconds, seed=2)
    assert recording.velocity is not None
    load, v = loads(tree, recording), recording.velocity
    more = loss[0] * np.abs(load) * np.sign(v) + loss[1] * np.abs(load) * v
    more += loss[2] * load * np.abs(v) + loss[3] * load**2 * np.sign(v)
    wide = noise * np.random.default_rng(1).normal(size=load.shape)
    found = plus(recording, torque=more)
    return replace(found, torque=found.measured("torque") * CONSTANTS + wide)


def findings(tree: tb.Tree, recording: Recording, **how: Any) -> DriveFindings:
    """Beside the plate's estimate from the same recording."""
    settings = how.pop("settings", EXACT)
    bodies = tb.identify(tree, recording, settings=settings)
    return identify_drives(tree, recording, bodies, settings=settings, **how)


def test_laws_of_the_load_are_found_exactly() -> None:
    """A sample's column is the law of its own load: else coefficients of exact data are off."""
    tree = rubbing_puma()
    settings = replace(EXACT, terms=("coulomb", "viscous", *LOADED))
    found = findings(tree, rubbing(tree, 20.0), settings=settings)
    for j, drive in enumerate(found.estimates):
        true = [tree.joints[j].coulomb, tree.joints[j].viscous, *LOSS[:, j]]
        assert drive.constant == pytest.approx(CONSTANTS[j], abs=1e-6)
        np.testing.assert_allclose([term.value for term in drive.terms], true, rtol=1e-4)


@pytest.mark.slow
def test_a_load_term_is_chosen_where_there_is_one_and_only_there() -> None:
    tree, none = rubbing_puma(), np.zeros_like(LOSS)
    loss = none.copy()
    loss[0, 1] = 0.1
    found = findings(tree, rubbing(tree, 40.0, loss, 0.5), choose=True)
    kinds = [{term.law.kind for term in drive.terms} for drive in found.estimates]
    assert ["load" in own for own in kinds] == [False, True, False]
    assert not set().union(*kinds) & set(LOADED[1:])
    (load,) = (term for term in found.estimates[1].terms if term.law.kind == "load")
    assert abs(load.value - 0.1) < 4 * load.sigma < 0.02


def test_no_row_of_drives_holds_a_reversal() -> None:
    """Hann's window ends half a period of the cutoff from its middle, where its gain is a half."""
    weights, nearby = drive_filter(tb.Settings(cutoff=5.0), 1000.0)
    at = np.arange(len(weights)) - len(weights) // 2
    assert np.abs(at).max() == nearby < 100
    np.testing.assert_allclose(weights, weights[::-1])
    for rate, gain in ((0.0, 1.0), (5.0, 0.5), (10.0, 0.0), (15.0, 0.0)):
        assert weights @ np.cos(2 * np.pi * rate * at / 1000) == pytest.approx(gain, abs=1e-3)


def bam_torque(values: dict[str, Any], load: float, speed: float) -> float:
    """What a BAM drive reports that moves a load slowly: its formulas, by hand.

    Friction depends on the motor's torque, which it is part of: a fixed point.
    """
    way, friction, fade = float(np.sign(speed)), 0.0, 0.0
    if "dtheta_stribeck" in values:
        fade = np.exp(-(abs(speed / values["dtheta_stribeck"]) ** values["alpha"]))
    for _ in range(100):
        motor, external = load + friction, -load
        dry = values["friction_base"] + fade * values.get("friction_stribeck", 0.0)
        sides = {"external": external, "motor": motor} if values["model"] in ("m5", "m6") else {}
        of_load = [values[f"load_friction_{side}"] * torque for side, torque in sides.items()]
        dry += abs(of_load[0] - of_load[1]) if of_load else 0.0
        if values["model"] == "m6" and motor * external < 0:
            side = "external" if abs(motor) > abs(external) else "motor"
            dry += fade * values[f"load_friction_{side}_quad"] * sides[side] ** 2
        friction = way * dry + values["friction_viscous"] * speed
    return float(values["constant"] * (load + friction))


@pytest.mark.slow
def test_friction_in_files_is_what_was_found(tmp_path: Path) -> None:
    """Read back by a computation of BAM's formula, and as a table."""
    tree, loss = rubbing_puma(), np.zeros_like(LOSS)
    loss[0] = 0.1
    settings = replace(EXACT, terms=("coulomb", "viscous", "stribeck@0.1", "load"))
    found = findings(tree, rubbing(tree, 20.0, loss), settings=settings)
    write_friction(found, tmp_path / "friction.json")
    bam = json.loads((tmp_path / "friction.json").read_text())
    quadratic = replace(found.estimates[0].terms[0], law=joint_law("quadratic_load"), value=2e-3)
    for drive in found.estimates:
        dry = drive.terms[:2]
        models = {"m5": drive.terms, "m2": drive.terms[:3], "m1": dry, "m6": (*dry, quadratic)}
        for model, terms in models.items():
            own = replace(drive, terms=terms)
            values = bam[drive.joint] if model == "m5" else bam_parameters(own)
            assert (values["model"], values["left_out"]) == (model, [])
            for load, speed in ((12.0, 0.05), (60.0, 0.2), (-7.0, -1.0), (40.0, 0.3)):
                friction = own.friction(np.array([speed]), np.array([load]))[0]
                want = own.constant * (load + friction)
                assert bam_torque(values, load, speed) == pytest.approx(want, rel=1e-9)
    evil = tuple(replace(curve, joint=f"={curve.joint}") for curve in found.curves)
    for curves, mark in ((found.curves, ""), (evil, "'=")):  # no formula of a spreadsheet
        write_friction(replace(found, curves=curves), tmp_path / "friction.csv")
        with (tmp_path / "friction.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == sum(len(curve.speed) for curve in curves)
        assert {row["joint"] for row in rows} == {f"{mark}{name}" for name in tree.names}
        for row in rows:  # nodes near zero reach across Stribeck's fall
            assert float(row["friction"]) == pytest.approx(float(row["law"]), abs=0.5)
