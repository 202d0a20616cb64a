"""Gyroscopic effect of spinning geared rotors, expressed in the bodies' inertias."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import ModelError
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.tree import Tree


def with_rotor_spin(tree: Tree, spins: Mapping[str, float]) -> Tree:
    """Tree with the angular momentum of spinning rotors added to the bodies' inertias.

    The product of gear ratio and rotor inertia is added to the moment of inertia of the joint's
    body about the joint axis. The same product is subtracted from this moment of the carrying body
    and from the joint's `rotor_inertia`. The minimal parameters of the returned tree then include
    the gyroscopic effect.

    Args:
        tree: Robot whose rotors are fixed to the carrying bodies.
        spins: Products of gear ratio and rotor inertia, keyed by joint name [kg m^2].

    Raises:
        UnknownName: No joint has the name.
        ModelError: A joint is prismatic, so that the bodies cannot represent the spin of its rotor.
    """
    for name, spin in spins.items():
        j = tree.index(name)
        joint = tree.joints[j]
        if not joint.revolute:
            raise ModelError(
                f"joint '{name}' slides: the spin of its rotor is not of the bodies"
            )
        tree = tree.with_inertia(j, _axial_inertia(joint.axis, spin))
        tree = tree.with_inertia(
            joint.parent, _axial_inertia(joint.carried_axis, -spin)
        )
        reduced_joint = replace(joint, rotor_inertia=joint.rotor_inertia - spin)
        tree = replace(
            tree, joints=(*tree.joints[:j], reduced_joint, *tree.joints[j + 1 :])
        )
    return tree


def _axial_inertia(axis: Array, moment: float) -> Inertia:
    """Massless inertia with a moment about a single axis through the frame's origin."""
    return Inertia(0.0, np.zeros(3), moment * np.outer(axis, axis))
