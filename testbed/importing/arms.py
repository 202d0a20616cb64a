"""Subsets of a robot's joints to which the columns of a log may belong."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence

from testbed.core.robot.grippers import finger_joints
from testbed.core.robot.tree import Tree

GRIPPER_PATTERN = r"finger|grip|hand|knuckle|thumb|jaw|claw|robotiq"
"""Words of joint names by which a gripper's joint is recognised; few loggers record grippers."""


def joint_sets(
    tree: Tree, names: Sequence[str], followed: Collection[str]
) -> Iterator[list[str]]:
    """Yield joint names without the gripper's joints, then only names before the first branching.

    Joints of a gripper are its fingers, and joints with a word of `GRIPPER_PATTERN` in the name.

    Args:
        tree: Robot.
        names: Joint names without the joints of a free base.
        followed: Names of joints that other joints follow, for example in a gripper's fingers.
    """
    tool = {tree.names[j] for j in finger_joints(tree, followed)}
    arm = [
        n
        for n in names
        if n not in tool and not re.search(GRIPPER_PATTERN, n, re.IGNORECASE)
    ]
    yield arm
    arm_indices = {tree.index(name) for name in arm}
    trunk: list[str] = []
    children = [k for k in arm_indices if tree.joints[k].parent not in arm_indices]
    while len(children) == 1:
        trunk += [tree.names[children[0]]]
        children = [k for k in arm_indices if tree.joints[k].parent == children[0]]
    yield trunk
