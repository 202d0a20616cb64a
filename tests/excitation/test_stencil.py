"""Derivatives without derivative code are exact, whatever the robot."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.dynamics.motion import Motion
from testbed.excitation.samples import Computed
from testbed.parameters.rules import Model
from tests.helpers.differences import samples_of, slopes_by_differences
from tests.helpers.robots import random_robot
from tests.helpers.runs import robot

ROBOTS = ("puma", "ur5", "gantry", "random")


def motion_of(tree: tb.Tree, seed: int, count: int = 4) -> tuple[tb.Motion, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return Motion(np.arange(float(count)), *rng.normal(size=(3, count, tree.n))), rng


def by_recursion(tree: tb.Tree, motion: tb.Motion, model: Model) -> Array:
    """Slopes of the recursion in `dynamics`, which shares no code with rows."""
    return slopes_by_differences(motion, lambda moved: Computed(tree, moved).forces(model))


@pytest.mark.parametrize("model", ["reaction", "dynamic"])
@pytest.mark.parametrize("name", ROBOTS)
def test_slopes_of_forces_are_those_of_differences(name: str, model: Model) -> None:
    tree = robot(name)
    motion, _ = motion_of(tree, 1)
    found = samples_of(tree, motion).force_slopes(model)
    wanted = by_recursion(tree, motion, model)
    np.testing.assert_allclose(found, wanted, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize("seed", range(6))
def test_rows_of_the_kernel_are_those_of_the_recursion(seed: int) -> None:
    """Forces by slots and values of minimal parameters, and by inverse dynamics."""
    tree = random_robot(np.random.default_rng(seed), 5).tree()
    motion, _ = motion_of(tree, seed)
    samples, computed = samples_of(tree, motion), Computed(tree, motion)
    for model in ("reaction", "dynamic"):
        wanted = computed.forces(model)
        np.testing.assert_allclose(samples.forces(model), wanted, atol=1e-11 * np.abs(wanted).max())
