"""MuJoCo's bedplate against the vector equations; the traps of logging a simulator."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.excitation.fourier import Fourier
from testbed.simulation.build import build_plant
from testbed.simulation.plant import Plant
from testbed.simulation.rollout import Rollout, Sampling, simulate_motion
from tests.helpers.paths import ROOT
from tests.helpers.robots import random_robot

WITNESS = 1e-12
PUMA = ROOT / "models/puma562.xml"


def sensed(plant: Plant, q: Array, qd: Array, effort: Array) -> tuple[Array, Array, Array]:
    """Acceleration, joint friction and bedplate wrench in one state of the plant."""
    data = mujoco.MjData(plant.model)
    data.qpos[plant.order], data.qvel[plant.order], data.ctrl[:] = q, qd, effort
    mujoco.mj_forward(plant.model, data)
    friction = -(data.qfrc_passive + data.qfrc_constraint)[plant.order]
    wrench = plant.bedplate_wrench(data.sensordata[plant.plate])
    return data.qacc[plant.order].copy(), friction, wrench


def run(
    tree: tb.Tree,
    path: Path,
    motion: Fourier,
    sampling: Sampling,
    step: float,
    friction: bool = True,
) -> Rollout:
    plant = build_plant(path, tree, step, friction=friction)
    tree = tree if friction else tree.without_friction()
    return simulate_motion(plant, tree, motion, 1.0, 60.0, sampling)


def waving(n: int) -> Fourier:
    rng = np.random.default_rng(n)
    return Fourier(0.5, np.zeros(n), 0.2 * rng.normal(size=(n, 2)), 0.2 * rng.normal(size=(n, 2)))


@pytest.fixture(scope="module")
def puma_plant(puma: tb.Tree) -> Plant:
    return build_plant(PUMA, puma, 1e-4)


def states(rng: np.random.Generator, count: int) -> Array:
    """Positions, velocities and efforts within the PUMA's reach, (count, 3, 3)."""
    drawn: Array = rng.uniform(-1, 1, (count, 3, 3)) * np.array([[[2.3], [2.0], [60.0]]])
    return drawn


def test_the_bedplate_sensor_reads_the_base_wrench(puma: tb.Tree, puma_plant: Plant) -> None:
    """1000 states with friction and damping on; the pedestal's weight is on the sensor."""
    drawn = states(np.random.default_rng(0), 1000)
    found = [sensed(puma_plant, *state) for state in drawn]
    qdd, friction, wrench = (np.array([f[k] for f in found]) for k in range(3))
    motion = tb.Motion(np.arange(1000.0), drawn[:, 0], drawn[:, 1], qdd)
    expected = tb.base_wrench(puma, motion) + puma_plant.tare
    assert np.abs(wrench - expected).max() <= WITNESS * np.abs(expected).max()
    forces = tb.joint_forces(puma, motion)
    assert np.abs(drawn[:, 2] - friction - forces).max() <= WITNESS * np.abs(forces).max()
    assert np.abs(friction).max() > 5.0


def test_friction_does_not_leak_into_the_reaction(puma: tb.Tree, puma_plant: Plant) -> None:
    """At the same (q, qd, qdd), with and without friction, the wrench is the same."""
    smooth = build_plant(PUMA, puma, 1e-4, friction=False)
    for q, qd, effort in states(np.random.default_rng(1), 200):
        qdd, friction, wrench = sensed(puma_plant, q, qd, effort)
        same, none, other = sensed(smooth, q, qd, effort - friction)
        assert np.abs(none).max() == 0
        np.testing.assert_allclose(same, qdd, rtol=1e-9, atol=1e-9)
        moved = tb.Motion(
            np.zeros(2), *(np.array([a, b]) for a, b in ((q, q), (qd, qd), (qdd, same)))
        )
        residue = np.diff(tb.base_wrench(puma, moved), axis=0)[0]  # of the unequal qdd
        leak = np.abs(wrench - other + residue).max() / np.abs(wrench).max()
        assert leak < 1e-13


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("form", ["urdf", "xml"])
def test_any_robot_can_be_put_on_a_plate(seed: int, form: str, tmp_path: Path) -> None:
    """Robots without a sensor get one; its wrench is the vector equations' plus the tare."""
    robot = random_robot(np.random.default_rng(seed), 1 + seed % 6)
    path = tmp_path / f"r.{form}"
    path.write_text(robot.urdf() if form == "urdf" else robot.mjcf())
    tree = tb.load_tree(path)
    done = run(tree, path, waving(tree.n), Sampling(500.0, 4, False, 0.0), 5e-4)
    true = done.truth
    motion = tb.Motion(done.time, true.position, true.velocity, true.acceleration)
    wrench = tb.base_wrench(tree, motion) + tb.pedestal_wrench(tree)
    assert np.abs(true.wrench - wrench).max() <= WITNESS * np.abs(wrench).max()
    forces = tb.joint_forces(tree, motion)
    assert np.abs(true.torque - true.friction - forces).max() <= WITNESS * np.abs(forces).max()


def test_a_turned_and_displaced_sensor_reads_the_same_wrench(
    puma: tb.Tree, puma_plant: Plant, tmp_path: Path
) -> None:
    """The wrench is given in bedplate axes about O^0, wherever the sensor sits."""
    path = tmp_path / "r.xml"
    text = PUMA.read_text().replace(
        'name="bedplate_sensor"', 'name="bedplate_sensor" pos=".1 -.2 .05" euler=".4 .5 .6"'
    )
    path.write_text(text)
    elsewhere = build_plant(path, puma, 1e-4)
    for q, qd, effort in states(np.random.default_rng(2), 20):
        _, _, here = sensed(puma_plant, q, qd, effort)
        _, _, there = sensed(elsewhere, q, qd, effort)
        np.testing.assert_allclose(there, here, atol=1e-11 * np.abs(here).max())


def test_the_plate_feels_the_motion_that_the_encoders_show(puma: tb.Tree) -> None:
    """Averaged samples, smooth joints: the wrench follows from positions alone.

    The trap: an integrator that treats velocities half a step late or damping implicitly
    is wrong here by 1e-3 and more, whatever its sensors say about themselves.
    """
    done = run(puma, PUMA, waving(3), Sampling(1000.0, 2, True, 0.2), 5e-4, friction=False)
    q, rate = done.truth.position, 1000.0
    qd = (q[2:] - q[:-2]) * rate / 2
    qdd = (q[2:] - 2 * q[1:-1] + q[:-2]) * rate**2
    shown = tb.base_wrench(puma, tb.Motion(done.time[1:-1], q[1:-1], qd, qdd))
    felt = done.truth.wrench - tb.pedestal_wrench(puma)
    gap = np.sqrt(np.mean((felt[1:-1] - shown) ** 2, axis=0) / np.mean(shown**2, axis=0))
    assert gap.max() < 1e-4


def test_the_acceleration_of_an_averaged_sample_is_the_gain_of_velocity(puma: tb.Tree) -> None:
    done = run(puma, PUMA, waving(3), Sampling(1000.0, 4, True, 0.1), 2.5e-4, friction=False)
    moved = np.diff(done.truth.position, axis=0) * 1000
    between = (done.truth.velocity[1:] + done.truth.velocity[:-1]) / 2
    np.testing.assert_allclose(moved, between, atol=1e-4)
    gained = np.diff(done.truth.velocity, axis=0) * 1000
    middle = (done.truth.acceleration[1:] + done.truth.acceleration[:-1]) / 2
    np.testing.assert_allclose(gained, middle, atol=0.01)


def test_the_same_experiment_gives_the_same_bits(puma_recording: tb.Recording) -> None:
    settings = ["motion.duration=10", "simulation.step=2.5e-4", "motion.candidates=10"]
    again = tb.simulate(tb.Experiment.load(ROOT / "experiments/table6.toml", settings))
    for group in ("position", "torque", "wrench"):
        np.testing.assert_array_equal(getattr(again, group), getattr(puma_recording, group))


def friction_law(velocity: Array) -> Array:
    coulomb, viscous = np.array([6.3, 5.5, 2.6]), np.array([5.80, 9.50, 3.98])
    return coulomb * np.sign(velocity) + viscous * velocity


def test_dry_friction_is_coulombs_above_a_hundredth_of_a_radian_a_second(puma: tb.Tree) -> None:
    true = run(puma, PUMA, waving(3), Sampling(1000.0, 4, False, 0.0), 2.5e-4).truth
    fast = np.abs(true.velocity) > 0.01
    np.testing.assert_allclose(true.friction[fast], friction_law(true.velocity)[fast], atol=1e-12)
    assert fast.mean() > 0.9


def test_the_drive_follows_its_reference(puma_recording: tb.Recording) -> None:
    true = puma_recording.truth
    assert true is not None
    assert max(puma_recording.facts["tracking_rms"].values()) < 2e-3
    fast = np.abs(true.velocity) > 0.1
    means = friction_law(true.velocity)  # of the mean velocity; the law is linear there
    np.testing.assert_allclose(true.friction[fast], means[fast], atol=1e-3)
