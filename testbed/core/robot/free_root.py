"""Trees with a free base in place of a root welded to the bedplate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.core.base.errors import ModelError
from testbed.core.robot.free_base import BASE_COORDINATES, N_BASE_COORDINATES
from testbed.core.robot.inertia import ZERO_INERTIA
from testbed.core.robot.tree import Joint, Tree


def with_free_base(tree: Tree) -> Tree:
    """Tree with a free base: six base coordinates precede the joints.

    The pedestal becomes the body "base", which the last base coordinate moves; the frame of this
    body is the bedplate frame of the given tree. The first five bodies are massless.

    Args:
        tree: Robot with the root welded to the bedplate.

    Raises:
        ModelError: A joint has the name of a base coordinate.
    """
    names = [name for name, _, _ in BASE_COORDINATES]
    conflicts = [name for name in tree.names if name in names]
    if conflicts:
        raise ModelError(
            f"joint '{conflicts[0]}' has the name of a coordinate of the base"
        )
    base_joints = [
        Joint(name, name, kind, k - 1, np.eye(3)[axis], np.zeros(3), np.eye(3))
        for k, (name, kind, axis) in enumerate(BASE_COORDINATES)
    ]
    renumbered = [
        replace(joint, parent=joint.parent + N_BASE_COORDINATES)
        for joint in tree.joints
    ]
    return replace(
        tree,
        joints=(*base_joints[:-1], replace(base_joints[-1], body="base"), *renumbered),
        inertias=(
            *(ZERO_INERTIA,) * (N_BASE_COORDINATES - 1),
            tree.pedestal,
            *tree.inertias,
        ),
        pedestal=ZERO_INERTIA,
        floating=True,
        lead=N_BASE_COORDINATES,
    )
