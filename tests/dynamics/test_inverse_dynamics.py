"""Forces, wrenches and poses of any robot: if these are wrong, every estimate and simulation is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.dynamics.force_derivatives import force_derivatives
from testbed.core.dynamics.newton_euler import parameter_regressor, poses, sample_slices
from testbed.core.parameters.rules import Signal
from testbed.core.robot.rotations import rotvec_to_matrix
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.robots import Robot, random_states
from tests.helpers.sensors import random_cut
from tests.helpers.strategies import Rng, few, rngs, robots, trees

WITNESS = 1e-12  # relative to the largest entry
MODELS: tuple[Signal, ...] = ("torque", "wrench")


def motion(rng: Rng, samples: int, n: int) -> tb.Motion:
    return tb.Motion(np.arange(samples, dtype=float), *random_states(rng, samples, n))


def near(found: Array, wanted: Array) -> bool:
    return bool(np.abs(found - wanted).max() <= WITNESS * np.abs(wanted).max(initial=1.0))


@few(40)
@given(robots((1, 10)), rngs)
def test_forces_wrench_and_poses_are_pinocchios(robot: Robot, rng: Rng) -> None:
    """The pedestal's weight included, under any gravity."""
    tree, model = robot.tree(), pin.buildModelFromXML(robot.urdf())
    states, data = motion(rng, 5, tree.n), model.createData()
    forces, wrench, *_ = by_pinocchio(
        robot.urdf(), tree, (states.q, states.qd, states.qdd), pedestal=True
    )
    assert near(tb.joint_forces(tree, states), forces)
    assert near(tb.base_wrench(tree, states) + tb.pedestal_wrench(tree), wrench)
    order = [model.getJointId(name) for name in tree.names]
    full = np.zeros(tree.n)
    full[[model.joints[k].idx_q for k in order]] = states.q[0]
    pin.forwardKinematics(model, data, full)
    for k, X_WB in zip(order, poses(tree, states.q), strict=True):
        np.testing.assert_allclose(X_WB.R_AB[0], data.oMi[k].rotation, atol=1e-12)
        np.testing.assert_allclose(X_WB.p_AB_A[0], data.oMi[k].translation, atol=1e-12)
    for here, there in zip(poses(tree, np.zeros((1, tree.n))), tree.zero_poses, strict=True):
        np.testing.assert_allclose(here.R_AB[0], there.R_AB, atol=1e-12)
        np.testing.assert_allclose(here.p_AB_A[0], there.p_AB_A, atol=1e-12)


@given(robots(), rngs, st.sampled_from(MODELS), st.booleans())
def test_regressors_give_the_forces(robot: Robot, rng: Rng, model: Signal, zeros: bool) -> None:
    """Minimal ones and all ten a body, also under a gravity that is not the file's."""
    tree = robot.tree()
    states, theta = motion(rng, 10, tree.n), tb.barycentric(tree)
    force_of = tb.joint_forces if model == "torque" else tb.base_wrench
    for gravity in (None, rng.normal(size=3) * 5):
        force = force_of(tree, states, gravity)
        minimal = tb.minimal_set(tree, model, gravity, zeros=zeros)
        phi = tb.regressor(tree, states, minimal)
        assert phi.shape == (*force.shape, minimal.count)
        assert near(phi @ minimal.values(theta), force)
        assert near(parameter_regressor(tree, states, model, gravity) @ theta.ravel(), force)
    there = tree.with_gravity(gravity)
    np.testing.assert_array_equal(force, force_of(there, states))
    np.testing.assert_array_equal(tb.pedestal_wrench(tree, gravity), tb.pedestal_wrench(there))


@few(20)
@given(robots((1, 8)), rngs)
def test_derivatives_of_forces_are_their_differences(robot: Robot, rng: Rng) -> None:
    """Errors of encoders become columns by these; more instants than one block holds; of a cut."""
    tree = robot.tree() if rng.random() < 0.5 else random_cut(robot.tree(), rng)
    states, theta = motion(rng, 515, tree.n), np.array(tb.barycentric(tree))
    whole = force_derivatives(tree, states, theta)
    assert near(whole.wrench, tb.base_wrench(tree, states))
    assert near(whole.torque, tb.joint_forces(tree, states))
    step, last = 1e-5, slice(510, 515)
    for slopes, force in (
        (whole.wrench_slopes, tb.base_wrench),
        (whole.torque_slopes, tb.joint_forces),
    ):
        size = max(np.abs(each).max() for each in vars(slopes).values())
        for joint in range(tree.n):
            for kind, each in enumerate((slopes.position, slopes.velocity, slopes.acceleration)):
                moved = np.zeros((3, 515, tree.n))
                moved[kind, :, joint] = step
                plus, minus = (
                    tb.Motion(states.t, states.q + x[0], states.qd + x[1], states.qdd + x[2])[last]
                    for x in (moved, -moved)
                )
                found = (force(tree, plus) - force(tree, minus)) / (2 * step)
                np.testing.assert_allclose(each[last, :, joint], found, atol=1e-7 * size)


@few(10)
@given(robots((2, 6)), rngs)
def test_derivatives_by_frames_are_those_of_other_trees(robot: Robot, rng: Rng) -> None:
    """Five displacements before each joint, and slides and turns of the base."""
    tree = robot.tree()
    states, theta = motion(rng, 5, tree.n), np.array(tb.barycentric(tree))
    whole = force_derivatives(tree, states, theta, frames=True)
    n, step = tree.n, 1e-6
    for joint in range(n):
        own = tree.joints[joint]
        X_PB = own.X_PB
        for k in range(3):
            axis = X_PB.R_AB @ np.eye(3)[k]
            forces = [
                _forces(tree, joint, states, offset=own.offset + s * axis) for s in (step, -step)
            ]
            found = (forces[0] - forces[1]) / (2 * step)
            at = n + 5 * joint + k
            slopes = np.concatenate(
                [whole.wrench_slopes.position[:, :, at], whole.torque_slopes.position[:, :, at]], 1
            )
            np.testing.assert_allclose(slopes, found, atol=1e-5 * max(1.0, np.abs(found).max()))
        first = np.cross(own.axis, np.eye(3)[np.abs(own.axis).argmin()])
        across = first / np.linalg.norm(first)
        for k, axis in enumerate((across, np.cross(own.axis, across))):
            forces = [
                _forces(tree, joint, states, rotation=own.rotation @ rotvec_to_matrix(s * axis))
                for s in (step, -step)
            ]
            found = (forces[0] - forces[1]) / (2 * step)
            at = n + 5 * joint + 3 + k
            slopes = np.concatenate(
                [whole.wrench_slopes.position[:, :, at], whole.torque_slopes.position[:, :, at]], 1
            )
            np.testing.assert_allclose(slopes, found, atol=1e-5 * max(1.0, np.abs(found).max()))
    # gravity turns the other way where the base turns; forces are about the bedplate's axes
    wrench = whole.wrench_slopes.position[:, :, 6 * n + 3 :]
    for k, axis in enumerate(np.eye(3)):
        g = [rotvec_to_matrix(-s * axis) @ tree.gravity for s in (step, -step)]
        torque = (tb.joint_forces(tree, states, g[0]) - tb.joint_forces(tree, states, g[1])) / (
            2 * step
        )
        size = max(1.0, np.abs(torque).max())
        found = whole.torque_slopes.position[:, :, 6 * n + 3 + k]
        np.testing.assert_allclose(found, torque, atol=1e-5 * size)
        here = (tb.base_wrench(tree, states, g[0]) - tb.base_wrench(tree, states, g[1])) / (
            2 * step
        )
        w = whole.wrench
        turned = np.concatenate([np.cross(axis, w[:, :3]), np.cross(axis, w[:, 3:])], axis=1)
        np.testing.assert_allclose(
            wrench[:, :, k], here + turned, atol=1e-5 * max(1.0, np.abs(here).max())
        )


def _forces(tree: tb.Tree, joint: int, states: tb.Motion, **changes: Any) -> Any:
    """Base wrench and torques of a tree with another frame of a joint, (M, 6 + n)."""
    joints = list(tree.joints)
    joints[joint] = replace(joints[joint], **changes)
    other = replace(tree, joints=tuple(joints))
    return np.concatenate([tb.base_wrench(other, states), tb.joint_forces(other, states)], axis=1)


@given(trees((3, 3)), rngs, st.integers(0, 2900))
@few(5)
def test_a_samples_forces_depend_on_it_alone(tree: tb.Tree, rng: Rng, first: int) -> None:
    """To the bit: samples are taken in blocks."""
    states = motion(rng, 3000, 3)
    part = slice(first, first + 100)
    whole = tb.base_wrench(tree, states)
    np.testing.assert_array_equal(whole[part], tb.base_wrench(tree, states[part]))
    for samples in (0, 3, 4, 9):
        taken = [np.arange(samples)[part] for part in sample_slices(samples, 4)]
        assert all(0 < len(part) <= 4 for part in taken)
        assert [k for part in taken for k in part] == list(range(samples))


def test_a_motion_of_the_wrong_shape_or_robot_is_refused(puma: tb.Tree) -> None:
    with pytest.raises(ValueError, match=r"qd.*3, 1"):
        tb.Motion(np.zeros(3), np.zeros((3, 2)), np.zeros((3, 1)), np.zeros((3, 2)))
    with pytest.raises(ValueError, match=r"2 .* 3"):
        tb.joint_forces(puma, motion(np.random.default_rng(0), 5, 2))
