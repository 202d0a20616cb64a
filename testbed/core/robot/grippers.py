"""Finger joints of grippers, recognised by their mimic joints."""

from __future__ import annotations

from collections.abc import Collection

from testbed.core.robot.tree import Tree


def finger_joints(tree: Tree, followed: Collection[str]) -> list[int]:
    """Indices of gripper finger joints: masters of mimic joints that have no child joints.

    Args:
        tree: Robot.
        followed: Names of the master joints of mimic joints.
    """
    parents = {joint.parent for joint in tree.joints}
    return [
        j for j, name in enumerate(tree.names) if name in followed and j not in parents
    ]
