"""MuJoCo's bedplate against the vector equations, wherever the sensor is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.robot.model_file import ModelFile
from testbed.simulation.build import build_plant
from testbed.simulation.plant import Plant
from testbed.simulation.sampled_loop import Sampling
from tests.helpers.plants import PUMA, run, sensed, waving
from tests.helpers.robots import random_robot

WITNESS = 1e-12


@pytest.fixture(scope="module")
def puma_plant(puma: tb.Tree) -> Plant:
    return build_plant(ModelFile(PUMA), puma, 1e-4)


def states(rng: np.random.Generator, count: int) -> Array:
    """Positions, velocities and efforts within the PUMA's reach, (count, 3, 3)."""
    drawn: Array = rng.uniform(-1, 1, (count, 3, 3)) * np.array([[[2.3], [2.0], [60.0]]])
    return drawn


@pytest.mark.slow
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


@pytest.mark.slow
def test_friction_does_not_leak_into_the_reaction(puma: tb.Tree, puma_plant: Plant) -> None:
    """At the same (q, qd, qdd), with and without friction, the wrench is the same."""
    smooth = build_plant(ModelFile(PUMA), puma, 1e-4, friction=False)
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
    elsewhere = build_plant(ModelFile(path), puma, 1e-4)
    for q, qd, effort in states(np.random.default_rng(2), 20):
        _, _, here = sensed(puma_plant, q, qd, effort)
        _, _, there = sensed(elsewhere, q, qd, effort)
        np.testing.assert_allclose(there, here, atol=1e-11 * np.abs(here).max())
