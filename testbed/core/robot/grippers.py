"""Joints of grippers."""

from __future__ import annotations

from collections.abc import Collection

from testbed.core.robot.tree import Tree


def fingers(tree: Tree, followed: Collection[str]) -> list[int]:
    """Indices of joints that others follow and that carry no other joint.

    Args:
        tree: The robot.
        followed: Names of joints that others follow.
    """
    carrying = {joint.parent for joint in tree.joints}
    return [
        j for j, name in enumerate(tree.names) if name in followed and j not in carrying
    ]
