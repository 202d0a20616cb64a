"""One gate for trees, whichever file they come from: only numbers that a robot can have."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from testbed.errors import ModelError
from testbed.robot.tree import Joint, Tree

UNIT = 1e-6
"""How far an axis's length may be from one: rounding in files."""


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
    tree.gravity_or(tree.gravity)
    if len(set(tree.names)) < tree.n:
        raise ModelError(f"{path}: two joints have the same name")
    for joint in tree.joints:
        fault = _fault(joint)
        if fault:
            raise ModelError(f"{path}: joint '{joint.name}' has {fault}")
    owners = [*(f"body '{joint.body}'" for joint in tree.joints), "the pedestal"]
    for owner, inertia in zip(owners, (*tree.inertias, tree.pedestal), strict=True):
        ten = np.concatenate([[inertia.mass], inertia.first_moment, inertia.tensor.ravel()])
        if not (np.abs(ten) < 1e12).all():  # NaN fails too
            raise ModelError(f"{path}: {owner} has a mass, centre or inertia that is no number")


def _fault(joint: Joint) -> str | None:
    placement = np.concatenate([joint.offset, joint.rotation.ravel(), joint.axis])
    if not np.isfinite(placement).all():
        return "a place or axis that is not a number"
    if abs(np.linalg.norm(joint.axis) - 1) > UNIT:
        return f"no direction: its axis is {joint.axis.tolist()}"
    low, high = joint.position_range
    if not low <= high:
        return f"a range that ends before it begins: {low:g} to {high:g}"
    for what in ("coulomb", "viscous", "rotor_inertia"):
        value = getattr(joint, what)
        if not 0 <= value < np.inf:
            return f"{what.replace('_', ' ')} {value:g}, which cannot be negative"
    for what in ("max_velocity", "max_effort"):
        value = getattr(joint, what)
        if not value > 0:
            return f"{what.replace('_', ' ')} {value:g}, which must be positive"
    return None
