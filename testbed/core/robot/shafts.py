"""Shafts: what turns with several joints, where friction and rotors may be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import ModelError
from testbed.core.robot.tree import Shaft, Tree

Shafts = Mapping[str, Mapping[str, float]]
"""By the shaft's name, how much it turns with each of its joints, by name."""


def with_shafts(tree: Tree, given: Shafts) -> Tree:
    """The same tree with shafts that turn with several joints.

    Args:
        tree: The robot.
        given: The shafts, in place of those that it has.

    Raises:
        UnknownName: There is no such joint.
        ModelError: A shaft is none.
    """
    made = []
    for name, turns in given.items():
        _check(tree, name, turns)
        listed = sorted(
            (tree.index(joint), float(turn)) for joint, turn in turns.items()
        )
        made.append(Shaft(name, tuple(listed)))
    coupled = replace(tree, shafts=tuple(made))
    turn = shares(coupled)[tree.n :]
    unit = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    for k, one in enumerate(unit):
        for other, two in enumerate(unit[:k]):
            # sine of the angle between the turns of two shafts that are the same one
            if np.linalg.norm(one - (one @ two) * two) < 1e-9:
                raise ModelError(
                    f"robot.coupling: '{made[other].name}' and '{made[k].name}' are one shaft; "
                    "keep one of them"
                )
    return coupled


def places(tree: Tree) -> tuple[str, ...]:
    """Where a term of the torques may be: the joints' names, then the shafts'."""
    return (*tree.names, *(shaft.name for shaft in tree.shafts))


def shares(tree: Tree) -> Array:
    """How much each place turns with each joint, (places, n): ones for the joints themselves."""
    found = np.eye(tree.n + len(tree.shafts), tree.n)
    for row, shaft in zip(found[tree.n :], tree.shafts, strict=True):
        row[:] = 0.0
        for joint, turn in shaft.turns:
            row[joint] = turn
    return found


def _check(tree: Tree, name: str, turns: Mapping[str, float]) -> None:
    what = f"robot.coupling: shaft '{name}'"
    if name in tree.names or not name or "/" in name:
        raise ModelError(
            f"{what} needs a name of its own, that no joint has and without '/'"
        )
    kinds = {tree.joints[tree.index(joint)].kind for joint in turns}
    numbers = all(
        isinstance(turn, int | float) and math.isfinite(turn) for turn in turns.values()
    )
    if len(turns) < 2 or not numbers or 0.0 in turns.values():
        raise ModelError(
            f"{what} turns with two joints or more, each by a finite number that is not zero, "
            f"found {dict(turns)!r:.80}"
        )
    if len(kinds) > 1:
        raise ModelError(
            f"{what} turns with revolute and prismatic joints: that has no one unit"
        )
