"""Sets of a robot's joints to which the columns of a log may belong."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence

from testbed.core.robot.grippers import fingers
from testbed.core.robot.tree import Tree

GRIPPER = r"finger|grip|hand|knuckle|thumb|jaw|claw|robotiq"
"""Words in names of joints of a tool, which few loggers write."""


def joint_sets(
    tree: Tree, names: Sequence[str], followed: Collection[str]
) -> Iterator[list[str]]:
    """Joints without those of a gripper; of these the ones before the first branching.

    Args:
        tree: The robot.
        names: Its joints without those of a free base.
        followed: Joints that others follow, as one finger the other.
    """
    tool = {tree.names[j] for j in fingers(tree, followed)}
    arm = [
        n for n in names if n not in tool and not re.search(GRIPPER, n, re.IGNORECASE)
    ]
    yield arm
    kept = {tree.index(name) for name in arm}
    trunk: list[str] = []
    carried = [k for k in kept if tree.joints[k].parent not in kept]
    while len(carried) == 1:
        trunk += [tree.names[carried[0]]]
        carried = [k for k in kept if tree.joints[k].parent == carried[0]]
    yield trunk
