"""Robots whose root is free to move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.core.base.errors import ModelError
from testbed.core.robot.free_base import COORDINATES, FREE
from testbed.core.robot.inertia import NOTHING
from testbed.core.robot.tree import Joint, Tree


def on_free_base(tree: Tree) -> Tree:
    """The robot with its root free: the pedestal is the base, and its frame the bedplate's.

    Args:
        tree: The robot with its root welded.

    Raises:
        ModelError: A joint has the name of a coordinate of the base.
    """
    names = [name for name, _, _ in COORDINATES]
    clash = [name for name in tree.names if name in names]
    if clash:
        raise ModelError(f"joint '{clash[0]}' has the name of a coordinate of the base")
    joints = [
        Joint(name, name, kind, k - 1, np.eye(3)[axis], np.zeros(3), np.eye(3))
        for k, (name, kind, axis) in enumerate(COORDINATES)
    ]
    moved = [replace(joint, parent=joint.parent + FREE) for joint in tree.joints]
    return replace(
        tree,
        joints=(*joints[:-1], replace(joints[-1], body="base"), *moved),
        inertias=(*(NOTHING,) * (FREE - 1), tree.pedestal, *tree.inertias),
        pedestal=NOTHING,
        floating=True,
        lead=FREE,
    )
