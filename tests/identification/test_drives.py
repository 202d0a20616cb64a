"""Drives held against the plate, and terms of the torques, chosen by held-out data."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import testbed as tb
from testbed.applications.drives.friction_curves import friction_curves
from testbed.applications.drives.identify_drives import (
    DriveFindings,
    combined,
    identify_drives,
    with_drives,
)
from testbed.applications.drives.joint_regression import regressions, torques_beside
from testbed.bodies.write_model import write_model
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.estimation.estimate import METHODS
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.selection.held_out import Parts, stretches
from testbed.core.estimation.selection.term_choice import choose_terms
from testbed.core.recordings.recording import Recording
from testbed.core.robot.force_sensor import ForceSensor, beyond_sensor
from testbed.core.robot.friction import QUADRATIC, ROTOR, stribeck
from testbed.core.robot.model_file import ModelFile
from testbed.core.robot.shafts import with_shafts
from testbed.importing.check.time_offset import delivered
from testbed.lab.simulation.replay import replay
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
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


def reported(tree: tb.Tree, recording: Recording) -> Recording:
    """By drives with such constants."""
    return replace(recording, torque=recording.measured("torque") * constants(tree))


def findings(tree: tb.Tree, recording: Recording, how: tb.Settings) -> DriveFindings:
    """Beside the plate's estimate from the same recording."""
    bodies = tb.identify(tree, recording, settings=how)
    return identify_drives(tree, recording, bodies, settings=how)


def errors(tree: tb.Tree, found: DriveFindings) -> tuple[Array, Array]:
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
    assert np.abs((both.constants - constants(tree)) / both.constant_sigma).max() < 4.5
    assert both.disagreement.chance > 0.003
    assert both.disagreement.diagnostics == ()


@pytest.mark.parametrize("name", ["puma", "ur5", "gantry"])
def test_a_force_sensor_shows_the_drives_beyond_it(name: str) -> None:
    """Exactly of exact data: those of the joints before it have nothing to be held against."""
    tree = driven(name)
    recording, lead = reported(tree, ideal(tree)), tree.n // 2
    cut = beyond_sensor(tree, links_of(tree), ForceSensor(tree.joints[lead - 1].body, name="s"))
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
    tip = beyond_sensor(tree, links_of(tree), ForceSensor(tree.joints[-1].body, name="s"))
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
    torques = torques_beside(Problem.of(tree, recording, "internal"), bodies)
    found = regressions(torques, bodies)
    both = combined(torques, bodies, found)
    assert min(each.reliability for each in found) < 0.97
    told = zip(found, constants(tree), both.constants, both.constant_sigma, strict=True)
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
    assert missing.chance < 1e-6
    assert missing.diagnostics
    assert cured.chance > 1e-3


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
        Problem.of(tree, measured(tree, 3, duration=2.0), "internal"), bodies
    ):
        assert len(curve.speed) == 0
        assert not curve.at(np.linspace(-1, 1, 5)).any()


@pytest.mark.slow
def test_the_speed_at_which_friction_fades_is_found() -> None:
    """By an outer loop of the internal estimate, for all joints alike."""
    tree = driven("puma", 0.0)
    recording = ideal(tree, 20.0, own={stribeck(0.2): np.full(tree.n, 2.0)})
    how = replace(EXACT, terms=("coulomb", "viscous", "stribeck"))
    found = tb.identify(tree, recording, "internal", settings=how)
    named = [name for name in found.names if name.startswith("stribeck@")]
    assert len(named) == tree.n
    speed = float(named[0].partition("@")[2].partition("/")[0])
    assert speed == pytest.approx(0.2, rel=0.1)
    truth = tb.minimal_set(tree, "dynamic").values(tb.barycentric(tree))
    np.testing.assert_allclose(found.base.values, truth, rtol=2e-2, atol=2e-2)


@pytest.mark.slow
def test_what_tells_no_drives_is_refused() -> None:
    """Another method, no torques, too few rows."""
    tree = driven("puma")
    recording = measured(tree, duration=4.0)
    bodies, others = (tb.identify(tree, recording, method) for method in METHODS)
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
    rows, spans = np.column_stack([x, y]), list(stretches(600, 6, reach))
    assert np.concatenate([np.arange(600)[own] for own, _ in spans]).tolist() == list(range(600))
    for own, beside in spans:
        wanted = max(own.start - reach, 0), min(own.stop + reach, 600)
        assert (beside.start, beside.stop) == wanted
    unseen = np.array([rows[own].T @ rows[own] for own, _ in spans])
    near = np.array([rows[beside].T @ rows[beside] for _, beside in spans])
    found = Parts(unseen, rows.T @ rows - near)
    for some in ([0], [0, 2], [0, 2, 3, 5]):
        for k, (part, beside) in enumerate(spans):
            seen = np.delete(np.arange(600), beside)
            fit = np.linalg.lstsq(x[seen][:, some], y[seen], rcond=None)[0]
            left = float(np.sum((y[part] - x[part][:, some] @ fit) ** 2))
            assert found.left(some)[k] == pytest.approx(left, rel=1e-9)
    one_more = np.column_stack([found.left([0, 2, k]) for k in (1, 3, 5)])
    np.testing.assert_allclose(found.left_with([0, 2], [1, 3, 5]), one_more, rtol=1e-9)


@pytest.mark.slow
def test_the_terms_of_a_made_up_robot_are_chosen() -> None:
    """A rotor here, quadratic friction there, and a shaft that rubs."""
    rng = np.random.default_rng(4)
    turning: list[int] = []
    while len(turning) < 2:
        tree = random_robot(rng, 4).tree()
        turning = [k for k, joint in enumerate(tree.joints) if joint.revolute][:2]
    tree = with_shafts(tree, {"shaft": {tree.names[k]: 1.0 for k in turning}})
    heavy, rough = np.eye(tree.n)[[tree.n - 1, 1]]
    recording = ideal(tree, 40.0, seed=4, own={ROTOR: 3.0 * heavy, QUADRATIC: 5.0 * rough})
    assert recording.velocity is not None
    speed = recording.velocity[:, turning].sum(axis=1)
    turn = np.isin(np.arange(tree.n), turning)
    rubs = (2.0 * np.sign(speed) + speed)[:, None] * turn
    noisy = plus(recording, torque=rubs + 0.05 * rng.normal(size=(recording.samples, tree.n)))
    found = choose_terms(Problem.of(tree, noisy, "internal"))
    assert found.after.rms < 0.3 * found.before.rms
    own = {f"quadratic/{tree.names[1]}", f"rotor/{tree.names[-1]}"}
    assert {"coulomb/shaft", "viscous/shaft", *own} <= set(found.words)


@cache
def two_motions() -> tuple[Recording, Recording]:
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
    model = ModelFile(ROOT / "models/puma562.xml")
    tree = model.tree()
    bodies = tb.identify(tree, seen)
    found = identify_drives(tree, seen, bodies)
    poor = tree.with_joints({n: {"coulomb": 1.0, "viscous": 1.0} for n in tree.names})
    written = tmp_path / "driven.xml"
    write_model(model, with_drives(poor, found), written, gears=found.gears)
    write_model(model, poor, tmp_path / "poor.xml")
    compiled = mujoco.MjModel.from_xml_path(str(written))
    gears = [compiled.actuator(name).gear[0] for name in tree.names]
    np.testing.assert_allclose(gears, [1 / each.constant for each in found.estimates], rtol=1e-12)
    near, far = (
        np.sqrt((replay(ModelFile(path), unseen) ** 2).mean(axis=0))
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
        replay(model, unseen.part(0, 100))


@pytest.mark.slow
def test_commands_that_act_late_are_written_as_a_delay(tmp_path: Path) -> None:
    """A controller trained without the delay of its drives oscillates on the robot."""
    late, true = 0.008, ModelFile(ROOT / "models/puma562.xml")
    tree = true.tree()

    def commanded(recording: Recording) -> Recording:
        ahead = np.minimum(recording.time + late, recording.time[-1])
        torque = CubicSpline(recording.time, recording.measured("torque"))(ahead)
        return replace(recording, torque=torque)

    seen, unseen = map(commanded, two_motions())
    bodies = tb.identify(tree, seen, zeros=True)
    acting, offset = delivered(tree, seen, bodies)
    assert abs(offset.delay + late) < 3 * offset.sigma < 1.5e-3
    found = identify_drives(tree, acting, bodies, settings=tb.Settings(zeros=True))
    errors = []
    for delay in (-offset.delay, 0.0):
        path = tmp_path / f"{delay}.xml"
        write_model(true, with_drives(tree, found), path, gears=found.gears, delay=delay)
        compiled = mujoco.MjModel.from_xml_path(str(path))
        np.testing.assert_array_equal(compiled.actuator_delay, delay)
        errors.append(np.sqrt((replay(ModelFile(path), unseen) ** 2).mean()))
    assert errors[0] < 0.5 * errors[1]
    with refuses(RecordingError, "commands"):
        delivered(tree, replace(seen, torque=np.roll(seen.measured("torque"), 30, axis=0)), bodies)
    urdf = ModelFile(MODELS["ur5"])
    said = write_model(urdf, urdf.tree(), tmp_path / "late.urdf", delay=late)
    assert [each.code for each in said] == ["model.delay"]


def test_joints_without_motors_get_one_and_other_actuators_stay(tmp_path: Path) -> None:
    text = (ROOT / "models/puma562.xml").read_text()
    bare = re.sub(r"<motor[^>]*joint=\"elbow\"[^>]*/>", "", text)
    servo = re.sub(r"<motor([^>]*joint=\"waist\")", r"<position\1", bare)
    source, path = tmp_path / "some.xml", tmp_path / "other.xml"
    source.write_text(servo)
    model = ModelFile(source)
    said = write_model(model, model.tree(), path, gears={"waist": 2, "shoulder": 3, "elbow": 4})
    assert [each.code for each in said] == ["model.actuators"]
    compiled = mujoco.MjModel.from_xml_path(str(path))
    joints = [compiled.joint(k).name for k in compiled.actuator_trnid[:, 0]]
    found = dict(zip(joints, compiled.actuator_gear[:, 0].tolist(), strict=True))
    assert found == {"waist": 1.0, "shoulder": 3.0, "elbow": 4.0}


@pytest.mark.parametrize("name", ["puma", "gantry"])
@pytest.mark.parametrize("seed", range(3))
def test_torques_do_not_tell_what_a_plates_unknown_zero_hides(name: str, seed: int) -> None:
    """Mass and zero are one number: what is said to be determined is within four sigma."""
    tree = driven(name)
    recording = plus(measured(tree, seed), wrench=[3.0, -2.0, 4.0, 0.5, 0.3, -0.4])
    plate = tb.identify(tree, recording, settings=replace(SETTINGS, nuisances=("bias",)))
    both = identify_drives(tree, recording, plate, settings=SETTINGS).combined
    truth = plate.minimal.values(tb.barycentric(tree))
    known = np.isfinite(both.sigma)
    hidden = {n for n, there in zip(both.names, known, strict=True) if not there}
    assert hidden
    assert hidden == {*plate.unidentifiable}
    assert np.abs((both.values - truth)[known] / both.sigma[known]).max() < 4
    assert both.disagreement.chance > 1e-4
