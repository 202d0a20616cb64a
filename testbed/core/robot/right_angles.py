"""Right angles of a model file that its digits round: they decide what can be identified."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import diagnose
from testbed.core.base.errors import quoted
from testbed.core.robot.rotations import from_vector
from testbed.core.robot.tree import Joint, Tree

NEAR = 1e-5
"""Angle to a right angle, or to none, that is rounding of six digits [rad]."""

EXACT = 1e-12
"""Angle that is rounding of the arithmetic alone [rad]."""


def with_right_angles(tree: Tree) -> Tree:
    """Robot whose joints' frames and axes are square or parallel where its file means that.

    Args:
        tree: As the file's digits have it.
    """
    level = tree.gravity / (np.linalg.norm(tree.gravity) or 1.0)
    joints, changed = list(tree.joints), []
    for k, joint in enumerate(tree.joints):
        before = level if joint.parent < 0 else tree.joints[joint.parent].axis
        rotation = next(_exact(joint, before), None)
        if rotation is not None:
            joints[k] = replace(joint, rotation=rotation)
            changed.append(joint.name)
    if not changed:
        return tree
    said = diagnose("model.right-angles", quoted(changed))
    return replace(tree, joints=tuple(joints), diagnostics=(*tree.diagnostics, said))


def _exact(joint: Joint, before: Array) -> Iterator[Array]:
    """Rotation R_PB near the joint's with right angles, (3, 3), if the file rounds them.

    Args:
        joint: Joint, of body B on body P.
        before: Axis of the joint before, or gravity's, along P, (3,).
    """
    R_PB, axis_P = joint.rotation, joint.carried_axis
    square = np.round(R_PB)
    if EXACT < np.abs(R_PB - square).max() < NEAR:
        yield square
    cosine = float(axis_P @ before)
    sine = float(np.linalg.norm(np.cross(axis_P, before)))
    exact = np.sign(cosine) * before
    if abs(cosine) < NEAR:
        exact = axis_P - cosine * before
    if EXACT < min(abs(cosine), sine) < NEAR:
        yield from_vector(np.cross(axis_P, exact)) @ R_PB
