"""Quarter turns that a model file gives with few digits: 1.5708 for half of pi.

Taken as they stand, every 0 and 1 of a rotation becomes a number and the equations fill with
terms of a millionth. `right_angles` takes such turns for what they are meant to be.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.arrays import Array
from testbed.robot.tree import Tree

MEANT = 1e-4
"""A turn this close to quarter turns [rad] is meant to be one."""
EXACT = 1e-14
"""Below this it is one, but for rounding."""


def right_angles(tree: Tree) -> Tree:
    """The tree with rotations and axes made of quarter turns where they almost are.

    Args:
        tree: Any robot.
    """
    joints = tuple(
        replace(joint, rotation=_squared(joint.rotation), axis=_squared(joint.axis))
        for joint in tree.joints
    )
    return replace(tree, joints=joints)


def almost_right(tree: Tree) -> dict[str, float]:
    """Joints with a rotation or axis that `right_angles` would change, and by how much [rad]."""
    found = {}
    for joint, squared in zip(tree.joints, right_angles(tree).joints, strict=True):
        off = max(
            float(np.abs(squared.rotation - joint.rotation).max()),
            float(np.abs(squared.axis - joint.axis).max()),
        )
        if off > EXACT:
            found[joint.name] = off
    return found


def _squared(values: Array) -> Array:
    """Whole numbers, if all of them almost are."""
    whole = np.round(values)
    return whole if np.abs(values - whole).max() < MEANT else values
