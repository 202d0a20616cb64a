"""Inertial parameters of a rigid body: mass, first moment, inertia tensor, pseudo-inertia.

Parameters are stored about the origin of the body frame, because wrenches are linear in these
parameters. Model files state inertias about the mass centre, hence the conversions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array, freeze_arrays, readonly_array, skew
from testbed.core.base.summary_table import Value
from testbed.core.base.transform import Transform

MAX_INERTIAL_PARAMETER = 1e12
"""Largest accepted magnitude of a mass, first moment or inertia [kg, kg m, kg m^2]."""


@dataclass(frozen=True, eq=False)
class Inertia(Value):
    """Mass, first moment and inertia tensor of a rigid body, relative to its frame.

    Moments are taken about the origin of the frame, in components along the axes of the frame.

    Attributes:
        mass: Mass [kg].
        first_moment: Product of mass and mass centre, (3,) [kg m].
        tensor: Symmetric inertia tensor, (3, 3) [kg m^2]; the off-diagonal entries are negative
            products of inertia, for example I_yz = -integral(y z dm).
    """

    mass: float
    first_moment: Array
    tensor: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", float(self.mass))
        freeze_arrays(self, first_moment=(3,), tensor=(3, 3))

    @staticmethod
    def about_centre(mass: float, com: ArrayLike, central: ArrayLike) -> Inertia:
        """Build an inertia from mass, mass centre and inertia about the mass centre.

        Args:
            mass: Mass [kg].
            com: Mass centre in the body frame, (3,) [m].
            central: Inertia about the mass centre, along the body axes, (3, 3) [kg m^2].
        """
        c = np.asarray(com, dtype=np.float64)
        return Inertia(mass, mass * c, np.asarray(central) - mass * skew(c) @ skew(c))

    @property
    def com(self) -> Array:
        """Mass centre in the body frame, (3,) [m]; zero for a massless body."""
        centre: Array = self.first_moment / self.mass if self.mass else np.zeros(3)
        return centre

    @property
    def radius(self) -> float:
        """Radius of gyration about the frame's origin [m]; zero for a massless body.

        The radius is sqrt(trace(S) / mass), where S is the matrix of second moments (see `pseudo`).
        """
        return (
            math.sqrt(max(np.trace(self.tensor) / 2 / self.mass, 0.0))
            if self.mass > 0
            else 0.0
        )

    @cached_property
    def central(self) -> Array:
        """Inertia tensor about the mass centre, along the body axes, (3, 3) [kg m^2]."""
        lever = skew(self.com)
        return readonly_array(
            self.tensor + self.mass * lever @ lever, (3, 3), "central"
        )

    @property
    def within_limits(self) -> bool:
        """True if all parameters are numbers with magnitudes of at most MAX_INERTIAL_PARAMETER."""
        ten = np.concatenate([[self.mass], self.first_moment, self.tensor.ravel()])
        return bool((np.abs(ten) <= MAX_INERTIAL_PARAMETER).all())  # NaN fails too

    @property
    def pseudo(self) -> Array:
        """Pseudo-inertia matrix [[S, h], [h', m]] about the frame's origin, (4, 4).

        S is the matrix of second moments, integral(r r' dm) [kg m^2], h is the first moment [kg m],
        and m is the mass [kg]. The matrix is positive semidefinite if and only if the body is
        physically consistent [WKS18].
        """
        matrix = np.empty((4, 4))
        matrix[:3, :3] = np.trace(self.tensor) / 2 * np.eye(3) - self.tensor
        matrix[:3, 3] = matrix[3, :3] = self.first_moment
        matrix[3, 3] = self.mass
        return matrix

    @staticmethod
    def of_pseudo(matrix: Array) -> Inertia:
        """Build an inertia from a pseudo-inertia matrix as defined in `pseudo`, (4, 4)."""
        second = matrix[:3, :3]
        return Inertia(
            matrix[3, 3], matrix[:3, 3], np.trace(second) * np.eye(3) - second
        )

    def transformed(self, X_AB: Transform) -> Inertia:
        """Inertia relative to frame A of a body that is given in frame B.

        Args:
            X_AB: Pose of body frame B in A.
        """
        rotation, position = X_AB.R_AB, X_AB.p_AB_A
        h = rotation @ self.first_moment
        lever, offset = skew(h), skew(position)
        rotated_tensor = rotation @ self.tensor @ rotation.T
        shift = offset @ lever + lever @ offset + self.mass * offset @ offset
        return Inertia(self.mass, h + self.mass * position, rotated_tensor - shift)

    def __add__(self, other: Inertia) -> Inertia:
        """Inertia of two bodies welded together, both relative to the same frame."""
        return Inertia(
            self.mass + other.mass,
            self.first_moment + other.first_moment,
            self.tensor + other.tensor,
        )


ZERO_INERTIA = Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
"""Inertia of a massless body."""


def upper_cholesky_factor(matrix: Array) -> Array:
    """Upper triangular Cholesky factor U of a pseudo-inertia matrix P = U U', (4, 4).

    U is the product of sqrt(mass) and the matrix of an affine map in homogeneous coordinates, with
    last row (0, 0, 0, 1).

    Args:
        matrix: Pseudo-inertia, (4, 4), positive definite.

    Raises:
        LinAlgError: The matrix is not positive definite.
    """
    return np.asarray(np.linalg.cholesky(matrix[::-1, ::-1])[::-1, ::-1])
