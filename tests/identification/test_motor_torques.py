"""Torques of motors: rotors, offsets that drift, friction that changes with temperature."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.core.base.errors import RecordingError
from testbed.core.recordings.recording import Recording
from testbed.core.robot.friction import SLOPE, VARYING, WARM_VISCOUS
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


def test_drift_and_temperature_are_chosen_where_they_explain_data(puma: tb.Tree) -> None:
    """By data that no fit has seen; of steady drives neither is."""
    kinds = {law.kind for law in VARYING}
    for seed in range(2):
        whole = measured(puma, seed, duration=40.0)
        speed = np.gradient(whole.position, whole.time, axis=0)
        for warm, expected in ((0.0, set[str]()), (1.0, {"slope/elbow", "warm_viscous/elbow"})):
            temperature = 25.0 + 20.0 * (1 - np.exp(-whole.time / 15.0))
            own = 0.05 * (whole.time - 20.0) - 0.05 * (temperature - 25.0) * speed[:, 2]
            recording = plus(whole, torque=warm * own[:, None] * [0.0, 0.0, 1.0])
            recording = replace(recording, temperature=np.tile(temperature[:, None], 3))
            found = tb.identify(puma, recording, "internal", settings=tb.Settings(terms="auto"))
            assert found.drives is not None
            chosen = [term for term in found.drives.asked if term.law.kind in kinds]
            assert {term.name(puma) for term in chosen} == expected


def test_what_motors_deliver_moves_rotors(tmp_path: Path) -> None:
    """Of currents, voltages and the motors' side of gears; a sensor at the joint has none."""
    cases = (
        ('unit = "A"\ngain = 3', "", "current"),
        ('unit = "pwm"\ngain = 3', "", "pwm"),
        ('unit = "V"\ngain = 3', "", "torque"),
        ('unit = "N m"', "", "torque"),
        ('unit = "N m"\nside = "motor"', 'side = "motor"', "motor"),
    )
    t = np.arange(2000) / 100.0
    q = np.sin(t * [[1.0], [1.7]]).T
    np.savetxt(tmp_path / "log.csv", np.column_stack([q, np.cos(q)]), delimiter=",",
               header="a,b,A,B", comments="")  # fmt: skip
    for torque, side, kind in cases:
        gear = "[gear]\nratio = [50, 50]\n" if side else ""
        recording = imported(
            tmp_path,
            f"""
            rate = 100
            joints = ["a", "b"]
            [sources.log]
            file = "log.csv"
            rate = 100
            {gear}
            [position]
            source = "log"
            columns = ["a", "b"]
            unit = "rad"
            {side}
            [torque]
            source = "log"
            columns = ["A", "B"]
            {torque}
            [temperature]
            source = "log"
            columns = ["A", "B"]
            unit = "degC"
        """,
        )
        assert recording.facts["effort"] == {"a": kind, "b": kind}
        np.testing.assert_allclose(recording.measured("temperature"), np.cos(q), atol=1e-12)


def test_rotors_are_the_cause_of_torques_that_lead_no_longer_beside_them() -> None:
    """Early torques are late encoders still, where rotors do not explain them."""
    tree = robot("ur5")
    joints = tuple(replace(j, rotor_inertia=0.3, coulomb=8.0, viscous=8.0) for j in tree.joints)
    geared = measured(replace(tree, joints=joints), duration=60.0)
    plain = measured(robot("gantry"), duration=60.0)
    early = replace(plain, torque=np.roll(plain.measured("torque"), -4, axis=0))
    cases = ((tree, geared, "rotor"), (robot("gantry"), early.part(8, 11992), "encoder_delays"))
    for each, recording, cause in cases:
        found = tb.identify(each, recording, "internal").diagnostics
        (told,) = (said for said in found if said.code == "torque.delay")
        assert told.causes[0] == cause
        assert "rotor" in told.causes
    motors = replace(geared, facts={"effort": dict.fromkeys(tree.names, "current")})
    right = tb.identify(tree, motors, "internal")
    assert "rotor/j6" in right.names
    assert not right.doubtful
