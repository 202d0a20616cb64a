"""Regressor of joint forces or of the base wrench on minimal parameters."""

from __future__ import annotations

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion, linear
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.robot.tree import Tree


def regressor(tree: Tree, motion: Motion, minimal: MinimalSet) -> Array:
    """Phi with phi delta = joint forces or base wrench; [FRS96] eqs. (10), (12).

    Takes 48 or 8 n bytes a sample and parameter: for small M and tests.

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples, columns in the order of `tree.names`.
        minimal: delta_d or delta_r; its gravity is used.

    Returns:
        (M, n, N) [N m or N per parameter] for a dynamic set, (M, 6, N) for a reaction set.
    """
    theta = minimal.lift.reshape(tree.n, 10, minimal.count)
    joints, base = linear(tree, motion, theta, minimal.gravity)
    return joints if minimal.model == "dynamic" else base
