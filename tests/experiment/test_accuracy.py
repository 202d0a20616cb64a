"""The headline's figures, held against inverse dynamics of another robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import testbed as tb
from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import base_wrench, joint_forces
from testbed.experiment.accuracy import accuracies
from testbed.identification.estimate import METHODS, Estimate
from testbed.robot.tree import Tree
from tests.helpers.ideal import ideal
from tests.helpers.runs import ROBOTS, robot, run_of


def heavier(tree: Tree, seed: int) -> Tree:
    """The robot with every body heavier or lighter by up to a fifth."""
    rng = np.random.default_rng(seed)
    inertias = [
        replace(
            body, mass=f * body.mass, first_moment=f * body.first_moment, tensor=f * body.tensor
        )
        for body, f in zip(tree.inertias, rng.uniform(0.8, 1.2, len(tree.inertias)), strict=True)
    ]
    return replace(tree, inertias=tuple(inertias))


def estimate_of(found: Estimate, tree: Tree) -> Estimate:
    """An estimate that says what a robot is."""
    values = np.array(found.values)
    values[: found.minimal.count] = found.minimal.values(tb.barycentric(tree))
    return replace(found, values=values)


def motion_of(recording: tb.Recording) -> tb.Motion:
    signals = (recording.measured(name) for name in ("position", "velocity", "acceleration"))
    return tb.Motion(recording.time, *signals)


def share(error: Array, signal: Array, same: NDArray[np.bool_]) -> float:
    return float(np.linalg.norm(error[:, same]) / np.linalg.norm(signal[:, same]))


@pytest.mark.parametrize("name", ROBOTS)
def test_the_figures_are_those_of_what_the_robot_would_do(name: str) -> None:
    tree, recording = robot(name), ideal(robot(name))
    run = run_of(tree, recording)
    motion = motion_of(recording)[::5]
    other = heavier(tree, 1)
    said = {method: estimate_of(run.estimates[method], other) for method in METHODS}
    found = accuracies(tree, said, False, motion)
    wrenches = [base_wrench(each, motion) for each in (tree, other)]
    wrenches = [each - each.mean(axis=0) for each in wrenches]
    parts = [np.arange(6) < 3, np.arange(6) >= 3]
    gap = wrenches[1] - wrenches[0]
    wanted = max(share(gap, wrenches[0], part) for part in parts)
    assert found["external"].wrench == pytest.approx(wanted, rel=1e-6)
    assert found["internal"].wrench is None
    torques = [joint_forces(each.without_friction(), motion) for each in (tree, other)]
    turns = np.array([joint.revolute for joint in tree.joints])
    gap = torques[1] - torques[0]
    wanted = max(share(gap, torques[0], part) for part in (turns, ~turns) if part.any())
    for method in METHODS:
        assert found[method].torque == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_parameter_near_zero_rules_nothing(name: str) -> None:
    """Wrong by its hundredfold, it moves the headline by no more than it moves the forces."""
    tree, recording = robot(name), ideal(robot(name))
    run = run_of(tree, recording)
    motion = motion_of(recording)
    true = {method: estimate_of(run.estimates[method], tree) for method in METHODS}
    right = accuracies(tree, true, False, motion)
    for method in METHODS:
        assert right[method].torque == pytest.approx(0.0, abs=1e-9)
        values = np.array(true[method].values)
        count = true[method].minimal.count
        least = int(np.argmin(np.abs(values[:count])))
        values[least] += 1e-4 * np.abs(values[:count]).max()
        wrong = accuracies(tree, {method: replace(true[method], values=values)}, False, motion)
        share_of_it = wrong[method].torque
        assert share_of_it is not None
        assert share_of_it < 0.05
