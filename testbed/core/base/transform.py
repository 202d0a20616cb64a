"""Rigid transforms of points, wrenches and twists, in monogram notation.

X_AB is the pose of frame B in frame A: R_AB maps components along the axes of B to components along
the axes of A, and p_AB_A is the vector from the origin of A to the origin of B, along the axes of
A. F_B is a wrench about the origin of B along the axes of B, force first; V_B is the twist at the
origin of B, linear part first.

Source    R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 2
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from testbed.core.base.arrays import AnyArray, multiply_vectors, skew


@dataclass(frozen=True, eq=False)
class Transform:
    """Pose X_AB of frame B in frame A, for one or many samples.

    Attributes:
        R_AB: Rotation from B to A, (..., 3, 3).
        p_AB_A: Position of B's origin, along A's axes, (..., 3) [m].
    """

    R_AB: AnyArray = field(default_factory=lambda: np.eye(3))
    p_AB_A: AnyArray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for name in ("R_AB", "p_AB_A"):
            array = np.array(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __matmul__(self, X_BC: Transform) -> Transform:
        """Composition X_AC = X_AB @ X_BC."""
        return Transform(self.R_AB @ X_BC.R_AB, self.point(X_BC.p_AB_A))

    @property
    def inverse(self) -> Transform:
        """Pose X_BA of frame A in frame B."""
        R_BA = np.swapaxes(self.R_AB, -1, -2)
        return Transform(R_BA, -multiply_vectors(R_BA, self.p_AB_A))

    @property
    def matrix(self) -> AnyArray:
        """Homogeneous matrix [[R_AB, p_AB_A], [0, 1]], (..., 4, 4)."""
        matrix = np.zeros((*self.p_AB_A.shape[:-1], 4, 4))
        matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = (
            self.R_AB,
            self.p_AB_A,
            1.0,
        )
        return matrix

    def point(self, p_B: AnyArray) -> AnyArray:
        """Coordinates in A of points given in B, (..., 3) [m]."""
        return multiply_vectors(self.R_AB, p_B) + self.p_AB_A

    def wrench(self, F_B: AnyArray) -> AnyArray:
        """Wrenches in frame A from wrenches F_B in frame B, (..., 6) [N, N m].

        Wrenches are force first, with components along the axes of the frame and the moment about
        its origin.
        """
        force = multiply_vectors(self.R_AB, F_B[..., :3])
        moment = multiply_vectors(self.R_AB, F_B[..., 3:]) + np.cross(
            self.p_AB_A, force
        )
        return np.concatenate([force, moment], axis=-1)

    @property
    def wrench_matrix(self) -> AnyArray:
        """Matrix that maps wrenches from B to A, (..., 6, 6), force first.

        Its transpose maps twists, linear part first, from A to B.
        """
        zeros = np.zeros_like(self.R_AB)
        return np.block(
            [[self.R_AB, zeros], [skew(self.p_AB_A) @ self.R_AB, self.R_AB]]
        )
