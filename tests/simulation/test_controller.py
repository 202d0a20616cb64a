"""The drive: its mass matrix is the robot's, its torque the model's and a decoupled loop's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.excitation.fourier import Fourier
from testbed.simulation.controller import Controller, computed_torque, mass_matrices
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.robots import Robot, random_robot, random_states

BANDWIDTH = 30.0
GRID = 500
"""Postures of a period at which a drive knows the mass matrix."""


def some_robot(seed: int) -> Robot:
    rng = np.random.default_rng(seed)
    return random_robot(rng, int(rng.integers(2, 8)))


def some_motion(n: int, seed: int) -> Fourier:
    rng = np.random.default_rng(seed)
    return Fourier(0.1, rng.normal(size=n), *(0.3 * rng.normal(size=(2, n, 3))))


def grid_times(motion: Fourier, rng: np.random.Generator) -> Array:
    """Instants of the grid, some periods before and after the first."""
    k = rng.permutation(GRID)[:6] + GRID * np.array([0, 1, -1, 3, -2, 0])
    times: Array = (k + 1e-6) / GRID * motion.period
    return times


def each(tree: tb.Tree, **changes: object) -> tb.Tree:
    return replace(tree, joints=tuple(replace(j, **changes) for j in tree.joints))  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(12))
def test_mass_matrices_are_pinocchios(seed: int) -> None:
    """Posture by posture, gravity or not."""
    robot = some_robot(seed)
    tree = robot.tree()
    states = random_states(np.random.default_rng(seed), 5, tree.n)
    expected = by_pinocchio(robot.urdf(), tree, states).mass
    found = mass_matrices(tree, states[0])
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


def errors_and_torques(drive: Controller, k: int) -> tuple[Array, Array, Array]:
    """A random distance from the reference, and what the drive adds for it."""
    rng = np.random.default_rng(k)
    late, slow = 0.01 * rng.normal(size=(2, drive.reference.q.shape[1]))
    q, qd = drive.reference.q[k], drive.reference.qd[k]
    return late, slow, drive.torque(k, q - late, qd - slow) - drive.torque(k, q, qd)


@pytest.mark.parametrize("seed", range(8))
def test_on_the_reference_torques_are_the_models(seed: int) -> None:
    tree, rng = some_robot(seed).tree(), np.random.default_rng(seed)
    motion = some_motion(tree.n, seed)
    times = rng.uniform(-20, 20, 10)
    drive = computed_torque(tree, motion, times, BANDWIDTH)
    wanted = motion.at(times)
    forces = tb.joint_forces(tree, wanted)
    for k in range(10):
        torque = drive.torque(k, wanted.q[k], wanted.qd[k])
        np.testing.assert_allclose(torque, forces[k], atol=1e-11 * np.abs(forces).max())


@pytest.mark.parametrize("rotor", [0.0, 0.7])
@pytest.mark.parametrize("seed", range(8))
def test_off_the_reference_every_joint_is_pulled_back_alike(seed: int, rotor: float) -> None:
    """Acceleration w^2 e + 2 (0.9) w e', by the mass matrix of the reference's posture."""
    robot, rng = some_robot(seed), np.random.default_rng(seed)
    tree = each(robot.tree(), rotor_inertia=rotor)
    motion = some_motion(tree.n, seed)
    times = grid_times(motion, rng)
    drive = computed_torque(tree, motion, times, BANDWIDTH)
    there = motion.at(times)
    mass = by_pinocchio(robot.urdf(), tree, (there.q, there.qd, there.qdd)).mass
    for k in range(len(times)):
        late, slow, added = errors_and_torques(drive, k)
        pulled = BANDWIDTH**2 * late + 2 * 0.9 * BANDWIDTH * slow
        expected = (mass[k] + rotor * np.eye(tree.n)) @ pulled
        np.testing.assert_allclose(added, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def test_rotors_and_losses_are_expected() -> None:
    """Dry friction as the sign of the speed; slower than 0.05 it fades."""
    tree = some_robot(1).tree()
    motion, times = some_motion(tree.n, 1), np.linspace(0, 10, 400)
    reference = motion.at(times)
    bare = computed_torque(tree, motion, times, BANDWIDTH).expected
    losing = each(tree, coulomb=2.0, viscous=0.3, rotor_inertia=0.1)
    besides = computed_torque(losing, motion, times, BANDWIDTH).expected - bare
    dry = besides - 0.3 * reference.qd - 0.1 * reference.qdd
    fast = np.abs(reference.qd) > 0.25
    np.testing.assert_allclose(dry[fast], 2 * np.sign(reference.qd)[fast], rtol=1e-3)
    slow = np.abs(reference.qd) < 0.005
    assert slow.any()
    np.testing.assert_allclose(dry[slow], 2 * reference.qd[slow] / 0.05, rtol=0.01, atol=1e-9)


def test_torques_stay_within_the_motors_limits() -> None:
    tree = some_robot(2).tree()
    motion = some_motion(tree.n, 2)
    free = computed_torque(tree, motion, np.zeros(1), BANDWIDTH)
    weak = computed_torque(each(tree, max_effort=0.5), motion, np.zeros(1), BANDWIDTH)
    far = free.reference.q[0] - 1.0, free.reference.qd[0]
    wanted, limited = free.torque(0, *far), weak.torque(0, *far)
    assert np.abs(wanted).max() > 0.5
    np.testing.assert_array_equal(limited, np.clip(wanted, -0.5, 0.5))
