"""Restoration of right angles between joint frames and axes after rounding in a model file.

Angles that are right or zero only to six digits would change the identifiable parameters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import make_diagnostic
from testbed.core.base.errors import quoted_list
from testbed.core.robot.rotations import rotvec_to_matrix
from testbed.core.robot.tree import Joint, Tree

MAX_ROUNDING_ANGLE = 1e-5
"""Largest deviation from a right or zero angle that is attributed to six-digit rounding [rad]."""

MIN_ROUNDING_ANGLE = 1e-12
"""Largest deviation that is attributed to floating-point error, and left unchanged [rad]."""


def with_right_angles(tree: Tree) -> Tree:
    """Tree whose rounded joint rotations have exact right or zero angles.

    The angles are those between the axes of the frames of a joint's body and the carrying body, and
    those between the axes of successive joints (for a joint on the bedplate, between gravity and
    the joint axis). An angle within MAX_ROUNDING_ANGLE of a right or zero angle is replaced by the
    exact angle; a diagnostic names the joints with changed rotations.

    Args:
        tree: Robot as read from the file.
    """
    gravity_direction = tree.gravity / (np.linalg.norm(tree.gravity) or 1.0)
    joints, changed = list(tree.joints), []
    for k, joint in enumerate(tree.joints):
        previous_axis = (
            gravity_direction if joint.parent < 0 else tree.joints[joint.parent].axis
        )
        rotation = next(_right_angle_rotations(joint, previous_axis), None)
        if rotation is not None:
            joints[k] = replace(joint, rotation=rotation)
            changed.append(joint.name)
    if not changed:
        return tree
    diagnostic = make_diagnostic("model.right-angles", quoted_list(changed))
    return replace(
        tree, joints=tuple(joints), diagnostics=(*tree.diagnostics, diagnostic)
    )


def _right_angle_rotations(joint: Joint, previous_axis: Array) -> Iterator[Array]:
    """Yield exact rotations R_PB near a joint's rotation, (3, 3), in order of preference.

    The first candidate is the rotation rounded to right angles between all axes of the two frames.
    The second candidate has a joint axis exactly parallel or normal to `previous_axis`. A candidate
    is yielded only if it deviates from the given rotation by more than MIN_ROUNDING_ANGLE and less
    than MAX_ROUNDING_ANGLE.

    Args:
        joint: Joint of body B on body P.
        previous_axis: Axis of the joint that moves body P, or gravity's direction; unit vector in
            frame P, (3,).
    """
    R_PB, axis_P = joint.rotation, joint.carried_axis
    square = np.round(R_PB)
    if MIN_ROUNDING_ANGLE < np.abs(R_PB - square).max() < MAX_ROUNDING_ANGLE:
        yield square
    cosine = float(axis_P @ previous_axis)
    sine = float(np.linalg.norm(np.cross(axis_P, previous_axis)))
    exact_axis = np.sign(cosine) * previous_axis
    if abs(cosine) < MAX_ROUNDING_ANGLE:
        exact_axis = axis_P - cosine * previous_axis
    if MIN_ROUNDING_ANGLE < min(abs(cosine), sine) < MAX_ROUNDING_ANGLE:
        yield rotvec_to_matrix(np.cross(axis_P, exact_axis)) @ R_PB
