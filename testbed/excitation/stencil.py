"""Exact derivatives of the rows by their motion, without derivative code.

A row of the equations of motion is linear in every acceleration, quadratic in every velocity, a
trigonometric polynomial of degree two in the position of a revolute joint and a polynomial of
degree two in that of a prismatic one. Differences of some width are then exact, whatever the
width, and wide ones lose nothing to rounding.

Source    for trigonometric polynomials: the parameter shift rule [Wierichs22]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array, readonly
from testbed.robot.tree import Joint, Tree

_NEAR, _FAR = np.pi / 4, 3 * np.pi / 4
_OF_NEAR, _OF_FAR = (1 / (8 * np.sin(shift / 2) ** 2) for shift in (_NEAR, _FAR))


@dataclass(frozen=True, eq=False)
class Stencil:
    """Where to look around a motion, and how much each look counts.

    Attributes:
        shifts: Of (q, qd, qdd), (E, 3, n); the first is none.
        weights: Derivatives by q, then qd, then qdd, of what is seen there, (3 n, E).
    """

    shifts: Array
    weights: Array

    def __post_init__(self) -> None:
        shifts = readonly(self.shifts, (None, 3, None), "shifts")
        object.__setattr__(self, "shifts", shifts)
        shape = (3 * shifts.shape[2], len(shifts))
        object.__setattr__(self, "weights", readonly(self.weights, shape, "weights"))

    def around(self, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array, Array]:
        """All looks at a motion, one after the other, (E M, n) each, of (M, n) each."""
        moved = np.stack([q, qd, qdd]) + self.shifts[:, :, None, :]  # (E, 3, M, n)
        flat = moved.transpose(1, 0, 2, 3).reshape(3, -1, q.shape[1])
        return flat[0], flat[1], flat[2]


def stencil(tree: Tree) -> Stencil:
    """The stencil of a robot's rows.

    Args:
        tree: The robot.
    """
    n = tree.n
    places: list[tuple[int, int, float]] = [(0, 0, 0.0)]
    weights: list[tuple[int, int, float]] = []  # derivative, look, weight
    for j, joint in enumerate(tree.joints):
        for kind, parts in enumerate((_position(joint), ((1.0, 0.5), (-1.0, -0.5)))):
            for shift, weight in parts:
                weights.append((kind * n + j, len(places), weight))
                places.append((kind, j, shift))
        weights += [(2 * n + j, len(places), 1.0), (2 * n + j, 0, -1.0)]
        places.append((2, j, 1.0))
    shifts, table = np.zeros((len(places), 3, n)), np.zeros((3 * n, len(places)))
    for look, (kind, j, shift) in enumerate(places):
        shifts[look, kind, j] = shift
    for derivative, look, weight in weights:
        table[derivative, look] += weight
    return Stencil(shifts, table)


def _position(joint: Joint) -> tuple[tuple[float, float], ...]:
    """Shifts of a position and their weights."""
    if not joint.revolute:
        return (1.0, 0.5), (-1.0, -0.5)
    return (_NEAR, _OF_NEAR), (-_NEAR, -_OF_NEAR), (_FAR, -_OF_FAR), (-_FAR, _OF_FAR)
