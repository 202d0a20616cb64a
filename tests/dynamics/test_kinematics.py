"""Where the bodies are."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from testbed.dynamics.kinematics import poses
from testbed.robot.visuals.shapes import poses_at_zero
from tests.helpers.robots import random_robot, random_states


@pytest.mark.parametrize("seed", range(8))
def test_poses_are_pinocchios(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, 5)
    tree = robot.tree()
    q, *_ = random_states(rng, 3, tree.n)
    model = pin.buildModelFromXML(robot.urdf())
    data = model.createData()
    for k in range(len(q)):
        full = np.zeros(tree.n)
        for j, name in enumerate(tree.names):
            full[model.joints[model.getJointId(name)].idx_q] = q[k, j]
        pin.forwardKinematics(model, data, full)
        for name, (rotation, position) in zip(tree.names, poses(tree, q), strict=True):
            placed = data.oMi[model.getJointId(name)]
            np.testing.assert_allclose(rotation[k], placed.rotation, atol=1e-12)
            np.testing.assert_allclose(position[k], placed.translation, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_poses_at_zero_are_those_of_the_shapes(seed: int) -> None:
    tree = random_robot(np.random.default_rng(seed), 5).tree()
    for here, there in zip(poses(tree, np.zeros((1, tree.n))), poses_at_zero(tree), strict=True):
        np.testing.assert_allclose(here[0][0], there[0], atol=1e-12)
        np.testing.assert_allclose(here[1][0], there[1], atol=1e-12)
