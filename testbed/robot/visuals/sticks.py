"""A figure of sticks, for a robot that no file draws."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.robot.tree import Tree
from testbed.robot.visuals.shapes import Shape, upright


def sticks(tree: Tree, thickness: float = 0.0) -> Iterator[Shape]:
    """A figure of sticks for a robot that no file draws: every body from its joint to the next.

    Args:
        tree: The robot.
        thickness: Of the sticks [m]; default a thirtieth of the longest offset.
    """
    longest = max((float(np.linalg.norm(j.offset)) for j in tree.joints), default=0.0) or 0.3
    radius = thickness or longest / 30
    grey, dark = np.array([0.72, 0.74, 0.78, 1.0]), np.array([0.25, 0.28, 0.33, 1.0])
    for j, joint in enumerate(tree.joints):
        length = float(np.linalg.norm(joint.offset))
        if length > radius:
            size, middle = np.array([radius, length / 2]), joint.offset / 2
            yield Shape(joint.parent, "capsule", size, middle, upright(joint.offset), grey)
        end = tree.inertias[j].com
        if not tree.children(j) and np.linalg.norm(end) > radius:
            half = np.array([radius, float(np.linalg.norm(end)) / 2])
            yield Shape(j, "capsule", half, end / 2, upright(end), grey)
        size = np.array([1.6 * radius, 2.4 * radius])
        yield Shape(j, "cylinder", size, np.zeros(3), upright(joint.axis), dark)
