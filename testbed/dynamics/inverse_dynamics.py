"""Joint forces, base wrench and regressors of a motion: the room's front door.

Samples are taken in blocks, so that intermediates stay in the processor's cache.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array
from testbed.dynamics.motion import Motion
from testbed.dynamics.newton_euler import NUMBERS, kinematics, transmitted
from testbed.parameters.barycentric import barycentric
from testbed.parameters.minimal_set import MinimalSet
from testbed.parameters.rules import Model
from testbed.robot.tree import Tree

BLOCK = 1024
"""Samples taken at once."""


def joint_forces(tree: Tree, motion: Motion, gravity: ArrayLike | None = None) -> Array:
    """What the motors deliver at the joints, friction excluded, (M, n) [N m or N].

    [FRS96] eqs. (6), (7), (20), (34): inverse dynamics.

    Args:
        tree: The robot.
        motion: M samples, columns in the order of `tree.names`.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    return linear(tree, motion, barycentric(tree)[..., None], gravity)[0][..., 0]


def base_wrench(tree: Tree, motion: Motion, gravity: ArrayLike | None = None) -> Array:
    """Wrench of the bedplate on the moving bodies, (M, 6) [N, N m].

    Force first, bedplate axes, moment about O^0; the pedestal is not included. [FRS96]
    eqs. (6), (7) for the first joints.

    Args:
        tree: The robot.
        motion: M samples, columns in the order of `tree.names`.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    return linear(tree, motion, barycentric(tree)[..., None], gravity)[1][..., 0]


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


def parameter_regressor(
    tree: Tree, motion: Motion, model: Model, gravity: ArrayLike | None = None
) -> Array:
    """The regressor on all barycentric parameters, (M, n or 6, 10 n).

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples, columns in the order of `tree.names`.
        model: "dynamic" for joint forces, "reaction" for the base wrench.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
    joints, base = linear(tree, motion, theta, gravity)
    return joints if model == "dynamic" else base


def pedestal_wrench(tree: Tree, gravity: ArrayLike | None = None) -> Array:
    """Wrench of the bedplate on the pedestal, which does not move, (6,) [N, N m].

    Args:
        tree: The robot.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    g = tree.gravity_or(gravity)
    pedestal = tree.pedestal
    return np.concatenate([-pedestal.mass * g, -np.cross(pedestal.first_moment, g)])


def blocks(samples: int, size: int = BLOCK) -> Iterator[slice]:
    """Consecutive slices of at most `size` samples."""
    return (slice(first, first + size) for first in range(0, samples, size))


def linear(
    tree: Tree, motion: Motion, theta: Array, gravity: ArrayLike | None = None
) -> tuple[Array, Array]:
    """Joint forces (M, n, p) and base wrench (M, 6, p) of p sets of parameters.

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples, columns in the order of `tree.names`.
        theta: Barycentric parameters, (n, 10, p).
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    if motion.q.shape[1] != tree.n:
        raise ValueError(f"a motion of {motion.q.shape[1]} joints, a robot of {tree.n}")
    g = tree.gravity_or(gravity)
    p = theta.shape[-1]
    joints, base = np.empty((motion.samples, tree.n, p)), np.empty((motion.samples, 6, p))
    for part in blocks(motion.samples):
        moving = kinematics(tree, motion.q[part], motion.qd[part], motion.qdd[part], g, NUMBERS)
        joints[part], base[part] = transmitted(tree, moving, theta, NUMBERS)
    return joints, base
