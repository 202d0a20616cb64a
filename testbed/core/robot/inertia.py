"""The ten inertial parameters of one rigid body, and whether a rigid body can have them.

Kept about the body frame's origin, where every wrench is linear in them; files speak of
the mass centre, so the passage from there is here too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array, freeze, readonly, skew
from testbed.core.base.summary_table import Value
from testbed.core.base.transform import Transform

HEAVIEST = 1e12
"""Masses, first moments and inertias beyond this are a mistake [kg, kg m, kg m^2]."""


@dataclass(frozen=True, eq=False)
class Inertia(Value):
    """Mass, first moment and inertia of one rigid body, about and along its body frame.

    Attributes:
        mass: [kg].
        first_moment: Mass times the mass centre, (3,) [kg m].
        tensor: Inertia about the frame's origin, (3, 3), symmetric [kg m^2]; products of
            inertia carry their minus sign, I_yz = -integral y z dm.
    """

    mass: float
    first_moment: Array
    tensor: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", float(self.mass))
        freeze(self, first_moment=(3,), tensor=(3, 3))

    @staticmethod
    def about_centre(mass: float, com: ArrayLike, central: ArrayLike) -> Inertia:
        """From mass [kg], mass centre (3,) [m] and inertia about it (3, 3) [kg m^2]."""
        c = np.asarray(com, dtype=np.float64)
        return Inertia(mass, mass * c, np.asarray(central) - mass * skew(c) @ skew(c))

    @property
    def com(self) -> Array:
        """Mass centre in the body frame, (3,) [m]; zero for a massless body."""
        centre: Array = self.first_moment / self.mass if self.mass else np.zeros(3)
        return centre

    @property
    def radius(self) -> float:
        """Radius of gyration about the frame's origin, by the sum of second moments [m]."""
        return (
            math.sqrt(max(np.trace(self.tensor) / 2 / self.mass, 0.0))
            if self.mass > 0
            else 0.0
        )

    @cached_property
    def central(self) -> Array:
        """Inertia about the mass centre, (3, 3) [kg m^2]."""
        lever = skew(self.com)
        return readonly(self.tensor + self.mass * lever @ lever, (3, 3), "central")

    @property
    def within_limits(self) -> bool:
        """Whether all are numbers, and none is beyond HEAVIEST."""
        ten = np.concatenate([[self.mass], self.first_moment, self.tensor.ravel()])
        return bool((np.abs(ten) <= HEAVIEST).all())  # NaN fails too

    @property
    def pseudo(self) -> Array:
        """Second moments, first moments and mass as one matrix, [[S, h], [h', m]], (4, 4).

        [WKS18]: positive semidefinite if and only if the body is of rigid matter.
        """
        found = np.empty((4, 4))
        found[:3, :3] = np.trace(self.tensor) / 2 * np.eye(3) - self.tensor
        found[:3, 3] = found[3, :3] = self.first_moment
        found[3, 3] = self.mass
        return found

    @staticmethod
    def of_pseudo(matrix: Array) -> Inertia:
        """From such a matrix, (4, 4)."""
        second = matrix[:3, :3]
        return Inertia(
            matrix[3, 3], matrix[:3, 3], np.trace(second) * np.eye(3) - second
        )

    def moved(self, X_AB: Transform) -> Inertia:
        """Inertia about and along frame A of a body given in frame B.

        Args:
            X_AB: Pose of the body frame B in A.
        """
        rotation, position = X_AB.R_AB, X_AB.p_AB_A
        h = rotation @ self.first_moment
        lever, offset = skew(h), skew(position)
        turned = rotation @ self.tensor @ rotation.T
        shift = offset @ lever + lever @ offset + self.mass * offset @ offset
        return Inertia(self.mass, h + self.mass * position, turned - shift)

    def __add__(self, other: Inertia) -> Inertia:
        """Two bodies welded together, both about the same frame."""
        return Inertia(
            self.mass + other.mass,
            self.first_moment + other.first_moment,
            self.tensor + other.tensor,
        )


NOTHING = Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
"""A body without matter."""


def upper_root(matrix: Array) -> Array:
    """U with U U' the pseudo-inertia, upper triangular: an affine map, and a root of the mass.

    Args:
        matrix: (4, 4), positive definite.

    Raises:
        LinAlgError: It is not.
    """
    return np.asarray(np.linalg.cholesky(matrix[::-1, ::-1])[::-1, ::-1])
