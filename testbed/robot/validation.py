"""One gate for trees, whichever file they come from: only numbers that a robot can have."""

from __future__ import annotations

from pathlib import Path

from testbed.errors import ModelError
from testbed.robot.inertia import HEAVIEST
from testbed.robot.model_xml import check_name
from testbed.robot.tree import Tree

MOST_JOINTS = 1_000
"""Matrices of a robot grow with the square of its joints."""


def check_tree(tree: Tree, path: Path) -> None:
    """Whether every number of a tree makes sense.

    Args:
        tree: What was read.
        path: The file, for the message.

    Raises:
        ModelError: Names the joint or body and the number.
    """
    if tree.n == 0:
        raise ModelError(f"{path}: the robot has no joint that moves")
    if tree.n > MOST_JOINTS:
        raise ModelError(f"{path}: {tree.n} joints that move; {MOST_JOINTS} is the limit")
    check_name(tree.name, "the robot's name", path)
    for joint in tree.joints:
        check_name(joint.name, "a joint's name", path)
        check_name(joint.body, "a body's name", path)
    try:
        tree.gravity_or(tree.gravity)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None
    if len(set(tree.names)) < tree.n:
        raise ModelError(f"{path}: two joints have the same name")
    for joint in tree.joints:
        flaw = joint.flaw()
        if flaw:
            raise ModelError(f"{path}: joint '{joint.name}' has {flaw}")
    owners = [*(f"body '{joint.body}'" for joint in tree.joints), "the pedestal"]
    for owner, inertia in zip(owners, (*tree.inertias, tree.pedestal), strict=True):
        if not inertia.within_limits:
            raise ModelError(
                f"{path}: {owner} has a mass, centre or inertia that is no number, or beyond "
                f"{HEAVIEST:g}"
            )
