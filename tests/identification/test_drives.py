"""Drives held against the plate, and terms of the torques, chosen by held-out data."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import testbed as tb
from testbed.applications.drives.friction_curves import friction_curves
from testbed.applications.drives.friction_files import bam_parameters, write_friction
from testbed.applications.drives.identify_drives import (
    DriveIdentification,
    combined,
    identify_drives,
    with_identified_drives,
)
from testbed.applications.drives.joint_regression import (
    fit_joint_regressions,
    torque_regression_data,
)
from testbed.bodies.write_model import write_model
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.windows import joint_law_filter
from testbed.core.estimation.selection.folds import Folds
from testbed.core.parameters.rules import SIGNALS
from testbed.core.recordings.metadata import Metadata
from testbed.core.robot.force_sensor import ForceSensor, tree_beyond_sensor
from testbed.core.robot.friction import DRIFT_LAWS, OFFSET_DRIFT, WARM_VISCOUS, joint_law
from testbed.importing.check.time_offset import with_drive_delay
from testbed.lab.simulation.replay import replay_errors
from tests.helpers.foreign_files import imported, npz, some_log
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.runs import MODELS, robot, without
from tests.helpers.sensors import links_of

TERMS = ("coulomb", "viscous", "rotor")
SETTINGS = tb.Settings(terms=TERMS)


def driven(name: str, rotor: float = 0.1) -> tb.Tree:
    """A robot with friction and rotors at every joint."""
    joints = {
        n: {"coulomb": 3.0 + k, "viscous": 2.0 + k, "rotor_inertia": rotor * (1 + k)}
        for k, n in enumerate(robot(name).names)
    }
    return robot(name).with_joints(joints)


def constants(tree: tb.Tree) -> Array:
    """Up to 8 % off."""
    return np.asarray(1 + 0.08 * np.sin(1.0 + np.arange(tree.n)))


def reported(tree: tb.Tree, recording: tb.Recording) -> tb.Recording:
    """By drives with such constants."""
    return replace(recording, torque=recording.measured("torque") * constants(tree))


def findings(
    tree: tb.Tree, recording: tb.Recording, how: tb.Settings, choose: bool = False
) -> DriveIdentification:
    """Beside the plate's estimate from the same recording."""
    bodies = tb.identify(tree, recording, settings=how)
    return identify_drives(tree, recording, bodies, settings=how, choose=choose)


def errors(tree: tb.Tree, found: DriveIdentification) -> tuple[Array, Array]:
    """Of constants, friction and rotors, joint by joint; and their sigmas, (n, 4)."""
    told, sigma = [], []
    for drive, joint, constant in zip(found.estimates, tree.joints, constants(tree), strict=True):
        assert (drive.joint, [term.law.kind for term in drive.terms]) == (joint.name, list(TERMS))
        true = [constant, joint.coulomb, joint.viscous, joint.rotor_inertia]
        told.append(np.array([drive.constant, *(term.value for term in drive.terms)]) - true)
        sigma.append([drive.sigma, *(term.sigma for term in drive.terms)])
    return np.array(told), np.array(sigma)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_constants_friction_and_rotors_are_found(name: str) -> None:
    """Exactly of exact data, within sigmas of noisy ones; together no worse than the plate."""
    tree = driven(name)
    exact = findings(tree, reported(tree, ideal(tree)), replace(EXACT, terms=TERMS))
    assert np.abs(errors(tree, exact)[0]).max() < 1e-5
    recording = reported(tree, measured(tree, 1, duration=30.0))
    bodies = tb.identify(tree, recording, settings=SETTINGS)
    found = identify_drives(tree, recording, bodies, settings=SETTINGS)
    gaps, sigma = errors(tree, found)
    assert np.abs(gaps / sigma).max() < 4.5
    assert 0.5 < np.sqrt(np.mean((gaps / sigma) ** 2)) < 1.6
    both = found.combined
    assert (both.sigma <= bodies.sigma * (1 + 1e-9)).all()
    truth = bodies.minimal.values(tb.barycentric(tree))
    assert np.abs((both.values - truth) / both.sigma).max() < 5
    scales = both.constants
    assert np.abs((scales.values - constants(tree)) / scales.sigma).max() < 4.5
    assert both.disagreement.p_value > 0.003
    assert both.disagreement.diagnostics == ()


@pytest.mark.parametrize("name", ["puma", "ur5", "gantry"])
def test_a_force_sensor_shows_the_drives_beyond_it(name: str) -> None:
    """Exactly of exact data: those of the joints before it have nothing to be held against."""
    tree = driven(name)
    recording, lead = reported(tree, ideal(tree)), tree.n // 2
    cut = tree_beyond_sensor(
        tree, links_of(tree), ForceSensor(tree.joints[lead - 1].body, name="s")
    )
    own = [tree.index(name) for name in cut.names]
    signals = ("position", "velocity", "acceleration")
    columns = (recording.measured(signal)[:, own] for signal in signals)
    felt = tb.base_wrench(cut, tb.Motion(recording.time, *columns))
    both = replace(recording, sensors=felt, sensor_names=("s",))
    bodies = tb.identify(cut, both, settings=EXACT)
    found = identify_drives(tree, both, bodies, settings=replace(EXACT, terms=TERMS))
    assert [each.joint for each in found.estimates] == list(cut.names[cut.lead :])
    for each in found.estimates:
        joint, k = tree.joints[tree.index(each.joint)], tree.index(each.joint)
        true = [constants(tree)[k], joint.coulomb, joint.viscous, joint.rotor_inertia]
        obtained = [each.constant, *(term.value for term in each.terms)]
        np.testing.assert_allclose(obtained, true, atol=1e-5)
    tip = tree_beyond_sensor(tree, links_of(tree), ForceSensor(tree.joints[-1].body, name="s"))
    with refuses(SettingsError):
        identify_drives(tree, both, tb.identify(tip, both, settings=EXACT), settings=EXACT)


@pytest.mark.slow
def test_a_poorly_known_load_does_not_make_constants_small() -> None:
    """A plate of thirty times the usual noise: errors of the bodies take part of a constant.

    Put back, constants are as the combined estimate has them, which has no columns with errors.
    """
    tree, rng = driven("ur5"), np.random.default_rng(3)
    plain = reported(tree, measured(tree, 3))
    noise = rng.normal(size=(plain.samples, 6)) * np.repeat([15.0, 3.0], 3)
    recording = plus(plain, wrench=noise)
    bodies = tb.identify(tree, recording)
    torques = torque_regression_data(Problem.from_recording(tree, recording, "torque"), bodies)
    found = fit_joint_regressions(torques, bodies)
    both = combined(torques, bodies, found)
    assert min(each.reliability for each in found) < 0.97
    scales = both.constants
    told = zip(found, constants(tree), scales.values, scales.sigma, strict=True)
    for each, true, constant, sigma in told:
        spread = float(np.sqrt(each.covariance[0, 0]))
        assert abs(each.values[0] - true) < 4 * spread
        assert abs(each.values[0] - constant) < 3 * np.hypot(spread, sigma)
        diluted = each.values[0] * each.reliability
        assert each.reliability > 0.8 or abs(diluted - true) > abs(each.values[0] - true)
    shared = [bodies.names.index(name) for name in both.disagreement.names]
    assert np.median(both.sigma[shared] / bodies.sigma[shared]) < 0.8


@pytest.mark.slow
def test_a_rotor_that_is_not_among_the_terms_is_caught() -> None:
    """The plate does not feel it, the torques do: the two then differ in the bodies."""
    recording = measured(driven("puma", 0.5))
    missing, cured = (
        findings(robot("puma"), recording, each).combined.disagreement
        for each in (tb.Settings(), SETTINGS)
    )
    assert missing.p_value < 1e-6
    assert missing.diagnostics
    assert cured.p_value > 1e-3


@pytest.mark.slow
def test_friction_over_velocity_is_the_law_at_every_node() -> None:
    """Straight between nodes, the curve is exact at any scale; noisy ones hold to their sigmas."""
    tree = driven("puma", 0.0)
    exact = findings(tree, reported(tree, ideal(tree, 20.0)), EXACT).curves
    noisy = findings(tree, measured(tree, 1, duration=30.0), tb.Settings()).curves
    scores = []
    for joint, constant, curve, rough in zip(
        tree.joints, constants(tree), exact, noisy, strict=True
    ):
        assert curve.constant == pytest.approx(constant, rel=1e-6)
        assert len(curve.speed) > 6
        assert (np.diff(curve.speed) >= 0).all()
        for each, most in ((curve, 1e-5), (rough, 0.5)):
            moving = np.abs(each.speed) > 0.02
            speed = each.speed[moving]
            off = each.torque[moving] - joint.coulomb * np.sign(speed) - joint.viscous * speed
            assert np.abs(off).max() < most
        scores.append(off / each.sigma[moving])
    every = np.concatenate(scores)
    assert np.abs(every).max() < 5
    assert 0.5 < np.sqrt(np.mean(every**2)) < 1.6
    bodies = tb.identify(tree, measured(tree))
    for curve in friction_curves(
        Problem.from_recording(tree, measured(tree, 3, duration=2.0), "torque"), bodies
    ):
        assert len(curve.speed) == 0
        assert not curve.torque_at_speed(np.linspace(-1, 1, 5)).any()


@pytest.mark.slow
def test_what_tells_no_drives_is_refused() -> None:
    """Another method, no torques, too few rows."""
    tree = driven("puma")
    recording = measured(tree, duration=4.0)
    bodies, others = (tb.identify(tree, recording, method) for method in SIGNALS)
    for kind, culprit, given, by in (
        (SettingsError, "plate", recording, others),
        (RecordingError, "torque", without(recording, "torque"), bodies),
        (RecordingError, f"'{tree.names[0]}'", measured(tree, 3, duration=0.85), bodies),
    ):
        with refuses(kind, culprit):
            identify_drives(tree, given, by)


@pytest.mark.parametrize("reach", [0, 7])
def test_what_is_left_is_what_plain_fits_leave(reach: int) -> None:
    """Of every row once, by rows that share no sample with it."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(600, 7)) * np.geomspace(0.1, 100, 7)
    y = x[:, [0, 2, 3]] @ np.array([10.0, 2.0, 0.1]) + rng.normal(size=600)
    rows, folds = np.column_stack([x, y]), Folds.equal_size(600, 6, reach)
    spans = [dict(folds.overlaps(0, 600, beside)) for beside in (0, reach)]
    assert np.concatenate([np.arange(600)[own] for own in spans[0].values()]).tolist() == [
        *range(600)
    ]
    for own, beside in zip(*(each.values() for each in spans), strict=True):
        wanted = max(own.start - reach, 0), min(own.stop + reach, 600)
        assert (beside.start, beside.stop) == wanted
    blocks = (block[None] for block in np.split(rows, [70, 300, 301, 555]))
    found = folds.products(blocks).weighted_sums(np.ones(1))
    for some in ([0], [0, 2], [0, 2, 3, 5]):
        for k, part in spans[0].items():
            seen = np.delete(np.arange(600), spans[1][k])
            fit = np.linalg.lstsq(x[seen][:, some], y[seen], rcond=None)[0]
            left = float(np.sum((y[part] - x[part][:, some] @ fit) ** 2))
            assert found.residual_squares(some)[k] == pytest.approx(left, rel=1e-9)
    one_more = np.column_stack([found.residual_squares([0, 2, k]) for k in (1, 3, 5)])
    np.testing.assert_allclose(
        found.squares_with_candidates([0, 2], [1, 3, 5]), one_more, rtol=1e-9
    )


@pytest.mark.parametrize("duration", [1.5, 3.0])
def test_terms_of_a_short_recording_are_those_of_every_joint(duration: float) -> None:
    """Parts of it that have no row leave nothing, and gain nothing."""
    tree = driven("puma")
    recording = measured(tree, duration=duration)
    found = findings(tree, recording, SETTINGS, choose=True)
    kinds = [tuple(term.law.kind for term in each.terms) for each in found.estimates]
    assert kinds == [TERMS] * tree.n
    rows = np.arange(12.0).reshape(1, 6, 2)
    none, some, *_ = Folds(np.array([0, 0, 4, 6])).products([rows]).test
    assert not none.any()
    np.testing.assert_array_equal(some[0], rows[0, :4].T @ rows[0, :4])


@cache
def two_motions() -> tuple[tb.Recording, tb.Recording]:
    words = ["motion.duration=8", "motion.candidates=1"]
    one, other = (
        tb.record(tb.Experiment.from_toml(ROOT / "experiments/table6.toml", [*words, f"seed={k}"]))
        for k in (5, 6)
    )
    return one, other


@pytest.mark.slow
def test_a_file_with_identified_drives_repeats_an_unseen_motion(tmp_path: Path) -> None:
    """Plain MuJoCo, driven open-loop by what drives report, stays near what was recorded."""
    seen, unseen = two_motions()
    model = tb.ModelFile(ROOT / "models/puma562.xml")
    tree = model.tree()
    bodies = tb.identify(tree, seen)
    found = identify_drives(tree, seen, bodies)
    poor = tree.with_joints({n: {"coulomb": 1.0, "viscous": 1.0} for n in tree.names})
    written = tmp_path / "driven.xml"
    write_model(model, with_identified_drives(poor, found), written, gears=found.gears)
    write_model(model, poor, tmp_path / "poor.xml")
    compiled = mujoco.MjModel.from_xml_path(str(written))
    gears = [compiled.actuator(name).gear[0] for name in tree.names]
    np.testing.assert_allclose(gears, [1 / each.constant for each in found.estimates], rtol=1e-12)
    near, far = (
        np.sqrt((replay_errors(tb.ModelFile(path), unseen) ** 2).mean(axis=0))
        for path in (written, tmp_path / "poor.xml")
    )
    assert (near < 0.1 * far).all()
    assert unseen.truth is not None
    data = mujoco.MjData(compiled)
    data.qpos[:], data.qvel[:] = unseen.truth.position[0], unseen.truth.velocity[0]
    compiled.opt.timestep = 1e-3
    for k in range(1000):
        data.ctrl[:] = unseen.measured("torque")[k]
        mujoco.mj_step(compiled, data)
    np.testing.assert_allclose(data.qpos, unseen.truth.position[1000], atol=0.05)
    with refuses(RecordingError, "0.2"):
        replay_errors(model, unseen.part(0, 100))


@pytest.mark.slow
def test_commands_that_act_late_are_written_as_a_delay(tmp_path: Path) -> None:
    """A controller trained without the delay of its drives oscillates on the robot."""
    late, true = 0.008, tb.ModelFile(ROOT / "models/puma562.xml")
    tree = true.tree()

    def commanded(recording: tb.Recording) -> tb.Recording:
        ahead = np.minimum(recording.time + late, recording.time[-1])
        torque = CubicSpline(recording.time, recording.measured("torque"))(ahead)
        return replace(recording, torque=torque)

    seen, unseen = map(commanded, two_motions())
    bodies = tb.identify(tree, seen, zeros=True)
    acting, offset = with_drive_delay(tree, seen, bodies)
    assert abs(offset.delay + late) < 3 * offset.sigma < 1.5e-3
    found = identify_drives(tree, acting, bodies, settings=tb.Settings(zeros=True))
    errors = []
    for delay in (-offset.delay, 0.0):
        path = tmp_path / f"{delay}.xml"
        write_model(true, with_identified_drives(tree, found), path, gears=found.gears, delay=delay)
        compiled = mujoco.MjModel.from_xml_path(str(path))
        np.testing.assert_array_equal(compiled.actuator_delay, delay)
        errors.append(np.sqrt((replay_errors(tb.ModelFile(path), unseen) ** 2).mean()))
    assert errors[0] < 0.5 * errors[1]
    with refuses(RecordingError, "commands"):
        with_drive_delay(
            tree, replace(seen, torque=np.roll(seen.measured("torque"), 30, axis=0)), bodies
        )
    urdf = tb.ModelFile(MODELS["ur5"])
    said = write_model(urdf, urdf.tree(), tmp_path / "late.urdf", delay=late)
    assert [each.code for each in said] == ["model.delay"]


def test_joints_without_motors_get_one_and_other_actuators_stay(tmp_path: Path) -> None:
    text = (ROOT / "models/puma562.xml").read_text()
    bare = re.sub(r"<motor[^>]*joint=\"elbow\"[^>]*/>", "", text)
    servo = re.sub(r"<motor([^>]*joint=\"waist\")", r"<position\1", bare)
    source, path = tmp_path / "some.xml", tmp_path / "other.xml"
    source.write_text(servo)
    model = tb.ModelFile(source)
    said = write_model(model, model.tree(), path, gears={"waist": 2, "shoulder": 3, "elbow": 4})
    assert [each.code for each in said] == ["model.actuators"]
    compiled = mujoco.MjModel.from_xml_path(str(path))
    joints = [compiled.joint(k).name for k in compiled.actuator_trnid[:, 0]]
    found = dict(zip(joints, compiled.actuator_gear[:, 0].tolist(), strict=True))
    assert found == {"waist": 1.0, "shoulder": 3.0, "elbow": 4.0}


@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_torques_do_not_tell_what_a_plates_unknown_zero_hides(name: str) -> None:
    """Mass and zero are one number: what is said to be determined is within four sigma."""
    tree = driven(name)
    recording = plus(measured(tree), wrench=[3.0, -2.0, 4.0, 0.5, 0.3, -0.4])
    plate = tb.identify(tree, recording, settings=replace(SETTINGS, nuisances=("bias",)))
    both = identify_drives(tree, recording, plate, settings=SETTINGS).combined
    truth = plate.minimal.values(tb.barycentric(tree))
    known = np.isfinite(both.sigma)
    hidden = {n for n, there in zip(both.names, known, strict=True) if not there}
    assert hidden
    assert hidden == {*plate.unidentifiable}
    assert np.abs((both.values - truth)[known] / both.sigma[known]).max() < 4
    assert both.disagreement.p_value > 1e-4


def warming(whole: tb.Recording, slope: float, warm: float) -> tb.Recording:
    """With drives that warm up by 20 K, offsets that drift and viscous friction that changes."""
    time, speed = whole.time[:, None], whole.measured("velocity")
    temperature = 45.0 - 20.0 * np.exp(-time / time[-1]) * np.ones_like(speed)
    drift = slope * (time - whole.samples / whole.rate / 2)
    return plus(
        replace(whole, temperature=temperature), torque=drift + warm * (temperature - 25.0) * speed
    )


def test_drift_and_temperature_are_terms_like_the_others(puma: tb.Tree, tmp_path: Path) -> None:
    """From memory, a file and parts; of another recording, whose drift is its own, friction is."""
    recording = warming(ideal(puma), 0.03, -0.05)
    asked = replace(
        EXACT, terms=("coulomb", "viscous", "offset", OFFSET_DRIFT.kind, WARM_VISCOUS.kind)
    )
    recording.save(tmp_path / "warm.parquet")
    parts = [recording.part(0, 700), recording.part(700, recording.samples)]
    for source in (recording, tmp_path / "warm.parquet", parts):
        found = tb.identify(puma, source, "torque", settings=asked)
        values = dict(zip(found.names, found.values.tolist(), strict=True))
        for name in puma.names:
            assert values[f"slope/{name}"] == pytest.approx(0.03, abs=1e-8)
            assert values[f"warm_viscous/{name}"] == pytest.approx(-0.05, abs=1e-8)
    other = warming(ideal(puma, seed=1), 0.0, -0.05)
    assert (tb.validate(found, other).residual < 1e-7).all()
    with refuses(RecordingError, "temperature"):
        tb.identify(puma, ideal(puma), "torque", settings=asked)


@pytest.mark.parametrize(
    ("size", "expected"), [(0.0, set[str]()), (1.0, {"slope/elbow", "warm_viscous/elbow"})]
)
def test_drift_and_temperature_are_chosen_where_they_explain_data(
    size: float, expected: set[str], puma: tb.Tree
) -> None:
    """By data that no fit has seen; of steady drives neither is."""
    kinds = {law.kind for law in DRIFT_LAWS}
    for seed in range(2):
        whole = measured(puma, seed, duration=40.0)
        speed = np.gradient(whole.position, whole.time, axis=0)
        temperature = 25.0 + 20.0 * (1 - np.exp(-whole.time / 15.0))
        own = 0.05 * (whole.time - 20.0) - 0.05 * (temperature - 25.0) * speed[:, 2]
        recording = plus(whole, torque=size * own[:, None] * [0.0, 0.0, 1.0])
        recording = replace(recording, temperature=np.tile(temperature[:, None], 3))
        found = tb.identify(puma, recording, "torque", settings=tb.Settings(terms="auto"))
        assert found.drives is not None
        chosen = [term for term in found.drives.asked if term.law.kind in kinds]
        assert {term.name(puma) for term in chosen} == expected


@pytest.mark.parametrize(
    ("torque", "kind"),
    [
        ('unit = "A"\ngain = 3', "current"),
        ('unit = "pwm"\ngain = 3', "pwm"),
        ('unit = "V"\ngain = 3', "torque"),
        ('unit = "N m"', "torque"),
        ('unit = "N m"\nside = "motor"', "motor"),
    ],
)
def test_what_motors_give_moves_rotors(torque: str, kind: str, tmp_path: Path) -> None:
    """Of currents, voltages and the motors' side of gears; a sensor at the joint has none."""
    log = some_log(1000)
    warm = '[temperature]\nsource = "log"\ncolumns = ["w[0]", "w[1]"]\nunit = "degC"'
    text = npz(tmp_path, log).replace('unit = "N m"', torque)
    if kind == "motor":
        text = text.replace('unit = "rad"', 'unit = "rad"\nside = "motor"')
        text += "[gear]\nratio = [50, 50]\n"
    recording = imported(tmp_path, f"{text}\n{warm}")
    assert recording.metadata.effort == dict.fromkeys(recording.names, kind)
    np.testing.assert_allclose(recording.measured("temperature"), log.w[:, :2], atol=1e-12)


def test_rotors_are_the_cause_of_torques_that_lead_no_longer_beside_them() -> None:
    tree = robot("ur5")
    joints = tuple(replace(j, rotor_inertia=0.3, coulomb=8.0, viscous=8.0) for j in tree.joints)
    geared = measured(replace(tree, joints=joints), duration=60.0)
    assert [each.family for each in tb.identify(tree, geared, "torque").model_errors] == ["rotor"]
    motors = replace(geared, metadata=Metadata(effort=dict.fromkeys(tree.names, "current")))
    right = tb.identify(tree, motors, "torque")
    assert "rotor/j6" in right.names
    assert not right.has_errors


# friction over velocity and load

LOADED = ("load", "viscous_load", "driving_load", "quadratic_load")
LOSS = np.array([[0.05, 0.1, 0.2], [0.01, 0.002, 0.03], [0.004, 0.003, 0.002], [1e-3, 2e-3, 4e-3]])
"""Of those laws, by joint."""


def rubbing(tree: tb.Tree, seconds: float, loss: Array = LOSS, noise: float = 0.0) -> tb.Recording:
    """By drives whose gears take more under load, with constants that are off."""
    recording = ideal(tree, seconds, seed=2)
    assert recording.truth is not None
    load, v = recording.truth.torque - recording.truth.friction, recording.truth.velocity
    more = loss[0] * np.abs(load) * np.sign(v) + loss[1] * np.abs(load) * v
    more += loss[2] * load * np.abs(v) + loss[3] * load**2 * np.sign(v)
    wide = noise * np.random.default_rng(1).normal(size=load.shape)
    return plus(reported(tree, plus(recording, torque=more)), torque=wide)


def test_laws_of_the_load_are_found_exactly() -> None:
    """A sample's column is the law of its own load: else coefficients of exact data are off."""
    tree = driven("puma", 0.0)
    settings = replace(EXACT, terms=("coulomb", "viscous", *LOADED))
    found = findings(tree, rubbing(tree, 20.0), settings)
    for j, drive in enumerate(found.estimates):
        true = [tree.joints[j].coulomb, tree.joints[j].viscous, *LOSS[:, j]]
        assert drive.constant == pytest.approx(constants(tree)[j], abs=1e-6)
        np.testing.assert_allclose([term.value for term in drive.terms], true, rtol=1e-4)


@pytest.mark.slow
def test_a_load_term_is_chosen_where_there_is_one_and_only_there() -> None:
    tree, none = driven("puma", 0.0), np.zeros_like(LOSS)
    loss = none.copy()
    loss[0, 1] = 0.1
    found = findings(tree, rubbing(tree, 40.0, loss, 0.5), EXACT, choose=True)
    kinds = [{term.law.kind for term in drive.terms} for drive in found.estimates]
    assert ["load" in own for own in kinds] == [False, True, False]
    assert not set().union(*kinds) & set(LOADED[1:])
    (load,) = (term for term in found.estimates[1].terms if term.law.kind == "load")
    assert abs(load.value - 0.1) < 4 * load.sigma < 0.02


def test_no_row_of_drives_holds_a_reversal() -> None:
    """Hann's window ends half a period of the cutoff from its middle, where its gain is a half."""
    weights, nearby = joint_law_filter(tb.Settings(cutoff=5.0), 1000.0)
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
        sides = {"wrench": external, "motor": motor} if values["model"] in ("m5", "m6") else {}
        of_load = [values[f"load_friction_{side}"] * torque for side, torque in sides.items()]
        dry += abs(of_load[0] - of_load[1]) if of_load else 0.0
        if values["model"] == "m6" and motor * external < 0:
            side = "wrench" if abs(motor) > abs(external) else "motor"
            dry += fade * values[f"load_friction_{side}_quad"] * sides[side] ** 2
        friction = way * dry + values["friction_viscous"] * speed
    return float(values["constant"] * (load + friction))


@pytest.mark.slow
def test_friction_in_files_is_what_was_found(tmp_path: Path) -> None:
    """Read back by a computation of BAM's formula, and as a table."""
    tree, loss = driven("puma", 0.0), np.zeros_like(LOSS)
    loss[0] = 0.1
    settings = replace(EXACT, terms=("coulomb", "viscous", "stribeck@0.1", "load"))
    found = findings(tree, rubbing(tree, 20.0, loss), settings)
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
