"""Motor shafts coupled to several joints, with friction and rotor inertia of the shaft."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import ModelError
from testbed.core.robot.tree import Shaft, Tree

ShaftRatios = Mapping[str, Mapping[str, float]]
"""Turns of the shaft per turn of the joint, keyed by shaft name, then by joint name."""


def with_shafts(tree: Tree, shafts: ShaftRatios) -> Tree:
    """Tree with motor shafts, each coupled to several joints.

    Args:
        tree: Robot.
        shafts: Turns of the shaft per turn of the joint, keyed by shaft, then by joint; these
            shafts replace the shafts of the given tree.

    Raises:
        UnknownName: No joint has the name.
        ModelError: The name or the ratios of a shaft are invalid, or two shafts have proportional
            ratios.
    """
    result = []
    for name, turns in shafts.items():
        _check_shaft(tree, name, turns)
        indexed_turns = sorted(
            (tree.index(joint), float(turn)) for joint, turn in turns.items()
        )
        result.append(Shaft(name, tuple(indexed_turns)))
    coupled = replace(tree, shafts=tuple(result))
    ratios = transmission_matrix(coupled)[tree.n :]
    directions = ratios / np.linalg.norm(ratios, axis=1, keepdims=True)
    for k, row in enumerate(directions):
        for other, other_row in enumerate(directions[:k]):
            # sine of the angle between proportional rows of ratios
            if np.linalg.norm(row - (row @ other_row) * other_row) < 1e-9:
                raise ModelError(
                    f"robot.coupling: '{result[other].name}' and '{result[k].name}' are one shaft; "
                    "keep one of them"
                )
    return coupled


def joint_and_shaft_names(tree: Tree) -> tuple[str, ...]:
    """Names of the joints, followed by the names of the shafts.

    A torque term acts at one joint or shaft of this list.
    """
    return (*tree.names, *(shaft.name for shaft in tree.shafts))


def transmission_matrix(tree: Tree) -> Array:
    """Transmission ratios of the n joints and s shafts relative to the joints, (n + s, n).

    Row k holds the turns of joint or shaft k of `joint_and_shaft_names` per turn of each joint. The
    n rows of the joints form the identity matrix; the s rows of the shafts hold their ratios.
    """
    ratios = np.eye(tree.n + len(tree.shafts), tree.n)
    for row, shaft in zip(ratios[tree.n :], tree.shafts, strict=True):
        row[:] = 0.0
        for joint, turn in shaft.turns:
            row[joint] = turn
    return ratios


def _check_shaft(tree: Tree, name: str, turns: Mapping[str, float]) -> None:
    """Check the name, the ratios and the joint kinds of a shaft.

    Raises:
        UnknownName: No joint has the name.
        ModelError: The name is empty, contains "/" or is the name of a joint; a ratio is zero or
            not finite; fewer than two joints are coupled; or revolute joints are coupled with
            prismatic joints.
    """
    label = f"robot.coupling: shaft '{name}'"
    if name in tree.names or not name or "/" in name:
        raise ModelError(
            f"{label} needs a name of its own, that no joint has and without '/'"
        )
    kinds = {tree.joints[tree.index(joint)].kind for joint in turns}
    all_finite = all(
        isinstance(turn, int | float) and math.isfinite(turn) for turn in turns.values()
    )
    if len(turns) < 2 or not all_finite or 0.0 in turns.values():
        raise ModelError(
            f"{label} turns with two joints or more, each by a finite number that is not zero, "
            f"found {dict(turns)!r:.80}"
        )
    if len(kinds) > 1:
        raise ModelError(
            f"{label} turns with revolute and prismatic joints: that has no one unit"
        )
