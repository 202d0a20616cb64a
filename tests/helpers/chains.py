"""Robots of joints in a row whose axes are chosen."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

import testbed as tb
from testbed.core.robot.tree import Joint, JointKind, Tree

X, Y, Z = np.eye(3)


def chain(*joints: tuple[JointKind, ArrayLike]) -> Tree:
    """Joints of given kinds and axes, each a step aside of the one before, on general bodies."""
    rng = np.random.default_rng(len(joints))
    made, bodies = [], []
    for k, (kind, axis) in enumerate(joints):
        place, name = np.full(3, 0.3 * (k > 0)), f"{k + 1}"
        made.append(Joint(f"j{name}", f"b{name}", kind, k - 1, np.array(axis), place, np.eye(3)))
        mass, centre = rng.uniform(1, 3), rng.uniform(-0.2, 0.2, 3)
        bodies.append(tb.Inertia.about_centre(mass, centre, np.eye(3) * 0.1))
    return Tree("chain", tuple(made), tuple(bodies))
