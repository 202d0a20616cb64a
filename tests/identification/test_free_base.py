"""Robots on a base that moves: what the ground's reaction tells, and a humanoid that squats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given

import testbed as tb
from testbed.core.base.errors import ModelError, RecordingError
from testbed.core.recordings.views import with_base_joints
from testbed.core.robot.free_base import coordinates
from testbed.core.robot.free_root import on_free_base
from tests.helpers.humanoid import G1, humanoid, squatting
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot
from tests.helpers.strategies import robots
from tests.scenarios.scenarios import result


def rank_by_pinocchio(model: pin.Model, states: int) -> int:
    """Of a free root's rows on all standard parameters at random states: no code of ours."""
    rng, data, rows = np.random.default_rng(0), model.createData(), []
    for _ in range(states):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.5, 1.5, model.nv))
        v, a = rng.uniform(-3, 3, (2, model.nv))
        rows.append(pin.computeJointTorqueRegressor(model, data, q, v, a)[:6].copy())
    whole = np.concatenate(rows)
    size = np.linalg.norm(whole, axis=0)
    return int(np.linalg.matrix_rank(whole / np.where(size > 0, size, 1.0), tol=1e-8))


@given(robots((1, 6)))
def test_the_minimal_set_is_as_large_as_pinocchios_rank(robot: Robot) -> None:
    """Under gravity and without it: else normal equations are singular, or something is lost."""
    model = pin.buildModelFromXML(robot.urdf(), pin.JointModelFreeFlyer())
    free = on_free_base(robot.tree())
    model.gravity.linear = free.gravity
    found = tb.minimal_set(free, "reaction")
    sliding = sum(not joint.revolute for joint in robot.tree().joints)
    assert found.count == rank_by_pinocchio(model, 10 + 2 * free.n)
    assert found.count == 10 + 7 * robot.tree().n - 3 * sliding


def test_the_grounds_wrench_is_pinocchios() -> None:
    """Of a humanoid, and 213 parameters; else a robot on a moving base is estimated as another."""
    tree, recording = humanoid(3.0, 100.0, 1, 0.0)
    free = on_free_base(tree)
    path = squatting(tree, 1).at(recording.time)
    np.testing.assert_allclose(tb.base_wrench(free, path), recording.measured("wrench"), atol=2e-5)
    np.testing.assert_allclose(with_base_joints(recording).position, path.q, atol=1e-12)
    model = pin.buildModelFromUrdf(str(G1), pin.JointModelFreeFlyer())
    assert tb.minimal_set(free, "reaction").count == rank_by_pinocchio(model, 60) == 213


@pytest.mark.slow
def test_a_squatting_humanoid_is_estimated() -> None:
    """As sigma says: a base that is taken for welded is off by thirty sigma."""
    run = result("free_base")
    found, free = run.estimates["external"], run.tree
    z = (found.values - found.minimal.values(tb.barycentric(free))) / found.sigma
    assert np.mean(np.abs(z) <= 3) >= 0.99  # of normal errors .9973
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.3  # single motions have .84 to 1.18
    mass = found.values[found.names.index("mbar6")]
    assert mass == pytest.approx(sum(b.mass for b in free.inertias), rel=2e-3)


def test_what_is_no_pose_is_refused() -> None:
    """Quaternions that are none, a pitch that Euler angles do not have, no base, two bases."""
    tree, recording = humanoid(0.5, 100.0, 5, 0.0)
    free, base = on_free_base(tree), recording.measured("base").copy()
    with refuses(RecordingError, "w, x, y, z"):
        coordinates(base * 2)
    base[:, 3:] = [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]
    with refuses(RecordingError, "80"):
        coordinates(base)
    with refuses(RecordingError, "base"):
        tb.identify(free, replace(recording, base=None))
    with refuses(ModelError, "base.x"):
        on_free_base(free)
