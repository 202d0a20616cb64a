"""Leaf to base: parameters that nobody can see apart are added into the carrying body.

Body j's redefined ("starred") parameters are its own plus what its children pass on; a
`Row` of the rules says which of them stay. What is passed on is affine in the offset
l^ij, and the coefficient of each component is kept apart, so that formulas can be printed
with the model's own lengths.

Source    [FRS96] eqs. (23), (38) and the redefinitions of Tables 2-5
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.parameters.barycentric import TENSOR, UPPER
from testbed.parameters.mobility import mobilities
from testbed.parameters.rules import Model, Row, base_rule, rule
from testbed.robot.free_base import FREE
from testbed.robot.tree import Joint, Tree

_UPPER = tuple(zip(*UPPER, strict=True))


@dataclass(frozen=True, eq=False)
class Body:
    """One body after regrouping.

    Attributes:
        row: What stays with it.
        passing: What it passes to its carrier, per unit and per component of the offset:
            (4, 10, 10), carrier's ten from own ten, for (1, lx, ly, lz).
        gain: The same with the model's offset, (10, 10).
    """

    row: Row
    passing: Array
    gain: Array


def regroup(tree: Tree, model: Model, gravity: Array) -> tuple[Body, ...]:
    """Apply the rules to every joint.

    Args:
        tree: The robot.
        model: "dynamic" for joint torques, "reaction" for the bedplate's wrench.
        gravity: In the bedplate frame, (3,) [m/s^2].
    """
    bodies = []
    for j, (joint, ahead) in enumerate(zip(tree.joints, mobilities(tree, gravity), strict=True)):
        of_base = tree.floating and j < FREE
        row = base_rule(is_base=j == FREE - 1) if of_base else rule(joint, ahead, model)
        passing = migration(joint, row)
        gain = np.tensordot(np.concatenate([[1.0], joint.offset]), passing, 1)
        bodies.append(Body(row, passing, gain))
    return tuple(bodies)


def redefined_parameters(tree: Tree, bodies: Sequence[Body]) -> Array:
    """The redefined parameters of every body on the barycentric ones, (n, 10, 10 n).

    From the tips to the base; dense, so its size grows with the square of the number of
    bodies.
    """
    redefined = np.zeros((tree.n, 10, 10 * tree.n))
    for j in reversed(range(tree.n)):
        redefined[j, range(10), range(10 * j, 10 * j + 10)] += 1.0
        if tree.parents[j] >= 0:
            redefined[tree.parents[j]] += bodies[j].gain @ redefined[j]
    return redefined


def migration(joint: Joint, row: Row) -> Array:
    """What body i gains from the ten redefined parameters of body j, (4, 10, 10).

    With b the migrating part of mb^j in frame i: mb*^i = mb^i + b and
    K*^i = K^i + (migrating part of K^j) - (l~ b~ + b~ l~), where
    l~ b~ + b~ l~ = b l' + l b' - 2 (l . b) 1.
    """
    if row.tensor == "none":
        return np.zeros((4, 10, 10))
    turn = joint.rotation
    b = turn @ row.passed  # (3, 3): b = this times mb^j
    gains = np.zeros((4, 10, 10))
    gains[0, 1:4, 1:4] = b
    if row.tensor == "all":
        tensor = np.einsum("ac,cdk,bd->abk", turn, TENSOR, turn)
    else:
        e = joint.carried_axis
        mean = (
            np.einsum("aak->k", TENSOR) - np.einsum("a,abk,b->k", joint.axis, TENSOR, joint.axis)
        ) / 2
        tensor = np.multiply.outer(np.eye(3) - np.outer(e, e), mean)
    gains[0, 4:, 4:] = [tensor[a, c] for a, c in _UPPER]
    for x in range(3):  # offset along axis x
        l = np.eye(3)[x]
        moved = (
            2 * np.multiply.outer(np.eye(3), b[x])
            - np.einsum("ak,b->abk", b, l)
            - np.einsum("a,bk->abk", l, b)
        )
        gains[1 + x, 4:, 1:4] = [moved[a, c] for a, c in _UPPER]
    gains[np.abs(gains) < 1e-15] = 0.0
    return gains
