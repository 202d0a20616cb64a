"""Robots of joints in a row whose axes are chosen."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

import testbed as tb
from testbed.robot.tree import Joint, Kind, Tree

X, Y, Z = np.eye(3)


def chain(*joints: tuple[Kind, ArrayLike], offset: float = 0.3) -> Tree:
    """Joints of given kinds and axes, each a step aside of the one before, on general bodies."""
    rng = np.random.default_rng(len(joints))
    made = tuple(
        Joint(f"j{k + 1}", f"b{k + 1}", kind, k - 1, np.array(axis), np.full(3, at), np.eye(3))
        for k, (kind, axis) in enumerate(joints)
        for at in [offset * (k > 0)]
    )
    bodies = tuple(
        tb.Inertia.about_centre(rng.uniform(1, 3), rng.uniform(-0.2, 0.2, 3), np.eye(3) * 0.1)
        for _ in joints
    )
    return Tree("chain", made, bodies)
