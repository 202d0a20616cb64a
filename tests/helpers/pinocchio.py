"""What Pinocchio says of a robot: a witness that shares no code with this project."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

import testbed as tb
from testbed.core.base.arrays import Array


class Witness(NamedTuple):
    """What Pinocchio finds in M states.

    Attributes:
        forces: Joint forces, (M, n).
        wrench: Of the bedplate on the robot, about O^0, (M, 6).
        mass: Mass matrices, (M, n, n).
        gravity: Joint forces that hold the robot at rest, (M, n).
    """

    forces: Array
    wrench: Array
    mass: Array
    gravity: Array


def by_pinocchio(
    urdf: str, tree: tb.Tree, states: tuple[Array, ...], *, pedestal: bool = False
) -> Witness:
    """Joint columns in the tree's order; the wrench is that of a free root held still.

    Args:
        urdf: The robot; joints of one degree of freedom.
        tree: Gives gravity and the order of joints.
        states: Positions, velocities, accelerations, (M, n) each.
        pedestal: Whether what stands still weighs on the bedplate, too.
    """
    fixed = pin.buildModelFromXML(urdf)
    floating = pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer())
    if not pedestal:
        floating.inertias[1] = pin.Inertia.Zero()
    found: list[list[Array]] = [[], [], [], []]
    order = [fixed.joints[fixed.getJointId(name)].idx_v for name in tree.names]
    for model in (fixed, floating):
        model.gravity.linear = tree.gravity
    data, other = fixed.createData(), floating.createData()
    for sample in zip(*states, strict=True):
        mine = [np.zeros(tree.n) for _ in range(3)]
        for into, values in zip(mine, sample, strict=True):
            into[order] = values
        mass = np.triu(pin.crba(fixed, data, mine[0]))
        mass = mass + np.triu(mass, 1).T
        root = [np.array([0, 0, 0, 0, 0, 0, 1.0]), np.zeros(6), np.zeros(6)]
        full = [np.concatenate([a, b]) for a, b in zip(root, mine, strict=True)]
        said = (
            pin.rnea(fixed, data, *mine)[order],
            pin.rnea(floating, other, *full)[:6].copy(),
            mass[np.ix_(order, order)],
            pin.computeGeneralizedGravity(fixed, data, mine[0])[order],
        )
        for values, one in zip(found, said, strict=True):
            values.append(one)
    return Witness(*(np.array(values) for values in found))
