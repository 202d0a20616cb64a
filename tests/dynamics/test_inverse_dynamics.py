"""Vector equations against Pinocchio, against MuJoCo's sensors, and against golden states."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array, skew
from testbed.dynamics.inverse_dynamics import blocks, parameter_regressor
from testbed.parameters.rules import Model
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.robots import random_robot, random_states

WITNESS = 1e-12  # relative to the largest entry
GOLDEN_TOLERANCE = 1e-10
MODELS: tuple[Model, ...] = ("dynamic", "reaction")


def motion(rng: np.random.Generator, samples: int, n: int) -> tb.Motion:
    return tb.Motion(np.arange(samples, dtype=float), *random_states(rng, samples, n))


@pytest.mark.parametrize("seed", range(200))
def test_joint_forces_and_base_wrench_are_pinocchios(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, int(rng.integers(1, 11)), gravity=rng.normal(size=3) * 6)
    tree = robot.tree()
    states = motion(rng, 5, tree.n)
    forces, wrench, *_ = by_pinocchio(
        robot.urdf(), tree, (states.q, states.qd, states.qdd), pedestal=True
    )
    base = tb.base_wrench(tree, states) + tb.pedestal_wrench(tree)
    assert np.abs(tb.joint_forces(tree, states) - forces).max() <= WITNESS * np.abs(forces).max()
    assert np.abs(base - wrench).max() <= WITNESS * np.abs(wrench).max()


def test_the_golden_states_of_the_puma(puma: tb.Tree, golden: Any) -> None:
    states = golden["variants"]["ref18_exact"]["states"]
    q, qd, qdd, forces, wrench = (
        np.array([state[key] for state in states]) for key in ("q", "qd", "qdd", "Q", "wrench")
    )
    given = tb.Motion(np.arange(len(q), dtype=float), q, qd, qdd)
    np.testing.assert_allclose(
        tb.joint_forces(puma, given), forces, rtol=GOLDEN_TOLERANCE, atol=GOLDEN_TOLERANCE
    )
    np.testing.assert_allclose(
        tb.base_wrench(puma, given), wrench, rtol=GOLDEN_TOLERANCE, atol=GOLDEN_TOLERANCE
    )


@pytest.mark.parametrize("model", ["dynamic", "reaction"])
@pytest.mark.parametrize("zeros", [False, True])
@pytest.mark.parametrize("seed", range(15))
def test_regressor_times_delta_is_the_force(seed: int, zeros: bool, model: Any) -> None:
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, int(rng.integers(1, 8))).tree()
    states, minimal = motion(rng, 10, tree.n), tb.minimal_set(tree, model, zeros=zeros)
    phi = tb.regressor(tree, states, minimal)
    force = (tb.joint_forces if model == "dynamic" else tb.base_wrench)(tree, states)
    assert phi.shape == (*force.shape, minimal.count)
    fitted = phi @ minimal.values(tb.barycentric(tree))
    assert np.abs(fitted - force).max() <= WITNESS * np.abs(force).max()


def test_a_robot_at_rest_weighs_on_the_plate(puma: tb.Tree) -> None:
    """Force of the bedplate on the robot: upwards, m g; moment about O^0: lever times weight."""
    rest = tb.Motion(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)))
    wrench = tb.base_wrench(puma, rest)[0]
    mass = sum(inertia.mass for inertia in puma.inertias)
    lever = sum(inertia.first_moment[1] for inertia in puma.inertias)
    np.testing.assert_allclose(wrench, [0, 0, mass * 9.81, lever * 9.81, 0, 0], atol=1e-12)
    assert tb.pedestal_wrench(puma)[2] == pytest.approx(25 * 9.81)


@pytest.mark.parametrize("seed", range(10))
def test_moments_transfer_to_another_origin(seed: int) -> None:
    """A bedplate frame moved by p sees L_P = L_0 - p x F_0."""
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, 5)
    tree, shift = robot.tree(), rng.normal(size=3)
    states = motion(rng, 3, tree.n)
    moved = tb.Tree(
        "moved",
        tuple(
            tb.Joint(
                j.name,
                j.body,
                j.kind,
                j.parent,
                j.axis,
                j.offset - shift if j.parent < 0 else j.offset,
                j.rotation,
            )
            for j in tree.joints
        ),
        tree.inertias,
    )
    here, there = tb.base_wrench(tree, states), tb.base_wrench(moved, states)
    np.testing.assert_allclose(there[:, :3], here[:, :3], atol=1e-11)
    np.testing.assert_allclose(there[:, 3:], here[:, 3:] - np.cross(shift, here[:, :3]), atol=1e-10)


@pytest.mark.parametrize("seed", range(10))
def test_motor_power_is_the_change_of_energy(seed: int) -> None:
    """Q . qd = d/dt (kinetic + potential), with energies from the standard inertias."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 6).tree()
    state = motion(rng, 1, tree.n)
    step = 1e-6

    def energy(t: float) -> float:
        q = state.q[0] + t * state.qd[0] + t * t / 2 * state.qdd[0]
        qd = state.qd[0] + t * state.qdd[0]
        return _energy(tree, q, qd)

    power = float(tb.joint_forces(tree, state)[0] @ state.qd[0])
    change = (energy(step) - energy(-step)) / (2 * step)
    assert power == pytest.approx(change, rel=1e-6, abs=1e-6)


def _energy(tree: tb.Tree, q: Array, qd: Array) -> float:
    """Kinetic and potential energy by plain rigid-body kinematics in the bedplate frame."""
    poses: list[tuple[Array, Array, Array, Array]] = []
    total: Any = 0.0
    for k, (joint, inertia) in enumerate(zip(tree.joints, tree.inertias, strict=True)):
        turn, origin, w, v = (
            poses[joint.parent]
            if joint.parent >= 0
            else (np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
        )
        at = origin + turn @ joint.offset
        v = v + np.cross(w, at - origin)
        turn = turn @ joint.rotation
        axis = turn @ joint.axis
        if joint.revolute:
            e = skew(joint.axis)
            turn = turn @ (np.eye(3) + np.sin(q[k]) * e + (1 - np.cos(q[k])) * e @ e)
            w = w + axis * qd[k]
        else:
            v = v + np.cross(w, axis * q[k]) + axis * qd[k]
            at = at + axis * q[k]
        poses.append((turn, at, w, v))
        centre = turn @ inertia.com
        speed = v + np.cross(w, centre)
        central = turn @ inertia.central @ turn.T
        total += inertia.mass * speed @ speed / 2 + w @ central @ w / 2
        total -= inertia.mass * tree.gravity @ (at + centre)
    return float(total)


def test_forces_do_not_depend_on_how_samples_are_blocked(puma: tb.Tree) -> None:
    states = motion(np.random.default_rng(0), 3000, 3)
    whole, part = tb.base_wrench(puma, states), tb.base_wrench(puma, states[1500:1600])
    np.testing.assert_array_equal(whole[1500:1600], part)


@pytest.mark.parametrize("seed", range(5))
def test_another_gravity_is_that_of_a_robot_in_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 4).tree()
    gravity = rng.normal(size=3) * 5
    there = replace(tree, gravity=gravity)
    states = motion(rng, 4, tree.n)
    for law in (tb.joint_forces, tb.base_wrench):
        np.testing.assert_array_equal(law(tree, states, gravity), law(there, states))
        assert not np.allclose(law(tree, states, gravity), law(tree, states))
    np.testing.assert_array_equal(tb.pedestal_wrench(tree, gravity), tb.pedestal_wrench(there))
    for model in MODELS:
        minimal = tb.minimal_set(tree, model, gravity)
        np.testing.assert_array_equal(
            tb.regressor(tree, states, minimal), tb.regressor(there, states, minimal)
        )
        np.testing.assert_array_equal(
            parameter_regressor(tree, states, model, gravity),
            parameter_regressor(there, states, model),
        )


@pytest.mark.parametrize("seed", range(5))
def test_a_pedestal_weighs_where_its_centre_is(seed: int) -> None:
    """Force minus m g, moment of that force about O^0."""
    tree = random_robot(np.random.default_rng(seed), 1).tree()
    wrench, weight = tb.pedestal_wrench(tree), tree.pedestal.mass * tree.gravity
    np.testing.assert_allclose(wrench[:3], -weight)
    np.testing.assert_allclose(wrench[3:], np.cross(tree.pedestal.com, -weight))


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(5))
def test_the_whole_regressor_times_barycentric_parameters_is_the_force(
    seed: int, model: Model
) -> None:
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 4).tree()
    states = motion(rng, 4, tree.n)
    force = (tb.joint_forces if model == "dynamic" else tb.base_wrench)(tree, states)
    rows = parameter_regressor(tree, states, model)
    np.testing.assert_allclose(rows @ tb.barycentric(tree).ravel(), force, atol=1e-10)


def test_the_motion_of_another_robot_is_refused(puma: tb.Tree) -> None:
    with pytest.raises(ValueError, match="a motion of 2 joints, a robot of 3"):
        tb.joint_forces(puma, motion(np.random.default_rng(0), 5, 2))


@pytest.mark.parametrize(("samples", "size"), [(0, 4), (3, 4), (4, 4), (9, 4)])
def test_blocks_are_all_samples_once_in_order(samples: int, size: int) -> None:
    taken = [np.arange(samples)[part] for part in blocks(samples, size)]
    assert all(0 < len(part) <= size for part in taken)
    assert [k for part in taken for k in part] == list(range(samples))
