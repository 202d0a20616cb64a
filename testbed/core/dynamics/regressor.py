"""Regressor of joint forces or of the base wrench on minimal parameters."""

from __future__ import annotations

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion, linear_inverse_dynamics
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.robot.tree import Tree


def regressor(tree: Tree, motion: Motion, minimal: MinimalSet) -> Array:
    """Regressor phi on minimal parameters delta: phi delta = joint forces or base wrench.

    [FRS96] eqs. (10), (12). The array has 8 n bytes (torques) or 48 bytes (wrench) per sample and
    parameter, so this function is meant for small M and for tests.

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples, columns in the order of `tree.names`.
        minimal: Minimal set of joint torques or of the base wrench, with its gravity.

    Returns:
        Regressor, (M, n, N) [N m or N per parameter] for joint torques, (M, 6, N) for the wrench.
    """
    theta = minimal.lift.reshape(tree.n, 10, minimal.count)
    joints, base = linear_inverse_dynamics(tree, motion, theta, minimal.gravity)
    return joints if minimal.model == "torque" else base
