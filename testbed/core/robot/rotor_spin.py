"""Contribution of the spin of geared rotors to the minimal parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import ModelError
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.tree import Tree


def with_rotor_spin(tree: Tree, spins: Mapping[str, float]) -> Tree:
    """The robot whose minimal parameters hold what its rotors' spin adds.

    Args:
        tree: The robot, rotors at rest on their carriers.
        spins: Ratio times inertia of the rotor, by joint name [kg m^2].

    Raises:
        UnknownName: There is no such joint.
        ModelError: The joint slides: its rotor's momentum is none of the bodies'.
    """
    for name, spin in spins.items():
        j = tree.index(name)
        joint = tree.joints[j]
        if not joint.revolute:
            raise ModelError(
                f"joint '{name}' slides: the spin of its rotor is not of the bodies"
            )
        tree = tree.with_inertia(j, _about(joint.axis, spin))
        tree = tree.with_inertia(joint.parent, _about(joint.carried_axis, -spin))
        left = replace(joint, rotor_inertia=joint.rotor_inertia - spin)
        tree = replace(tree, joints=(*tree.joints[:j], left, *tree.joints[j + 1 :]))
    return tree


def _about(axis: Array, size: float) -> Inertia:
    """Inertia about one axis alone."""
    return Inertia(0.0, np.zeros(3), size * np.outer(axis, axis))
