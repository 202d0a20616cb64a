"""Gaussian prior of a robot's parameters, centred on its model file, for force plates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.parameters.symbols import (
    barycentric,
    barycentric_from_standard,
    standard,
)
from testbed.core.robot.tree import Tree

MASS_SIGMA, CENTRE_SIGMA, MIN_MASS_SHARE = 0.4, 0.03, 0.1
"""Relative standard deviation of masses; standard deviation of centres of mass [m]; and least mass
for a body's standard deviations, relative to the robot's mass: tools missing from the model are at
light links."""


@dataclass(frozen=True, eq=False)
class ScaledPrior:
    """Prior of the barycentric parameters: mean and square root of the covariance.

    The parameters of each body are mass, first moments x, y, z, and tensor xx, xy, xz, yy, yz, zz,
    in the body's frame and augmented by the masses that the body carries [FRS96].

    Attributes:
        tree: Robot, with approximately right masses.
    """

    tree: Tree

    @cached_property
    def mean(self) -> Array:
        """Barycentric parameters according to the model file, (10 n,)."""
        return barycentric(self.tree).ravel()

    @cached_property
    def covariance_root(self) -> Array:
        """Square root of the prior covariance of the barycentric parameters, (10 n, 10 n).

        The standard deviations are: 40 % of masses; a length of 3 cm and 40 % of the distance from
        the joint for centres of mass; for inertias, 40 % and the mass times that length squared. A
        body below 10 % of the robot's mass has the standard deviations of a body with 10 %.
        """
        own = standard(self.tree)
        file, moments, tensor = own[:, :1], own[:, 1:4], own[:, 4:]
        mass = np.maximum(file, MIN_MASS_SHARE * file.sum())
        centre = np.linalg.norm(moments, axis=1, keepdims=True) / np.where(
            file > 0, file, 1.0
        )
        reach = CENTRE_SIGMA + MASS_SIGMA * centre
        lever = np.repeat(mass * reach, 3, axis=1)
        sigma = np.hstack(
            [MASS_SIGMA * mass, lever, MASS_SIGMA * np.abs(tensor) + mass * reach**2]
        )
        sigma[: self.tree.massless] = 0.0
        spread = np.diag(sigma.ravel()).reshape(self.tree.n, 10, -1)
        return barycentric_from_standard(self.tree, spread).reshape(sigma.size, -1)

    @property
    def weight(self) -> float:
        """Weight of the robot according to the model file [N]."""
        mass = sum(each.mass for each in self.tree.inertias)
        return float(mass * np.linalg.norm(self.tree.gravity))

    def zero_wrench(self, tare: Array | None) -> Array:
        """Wrench on the plate without the moving bodies, (6,) [N, N m].

        Args:
            tare: Wrench stated by the recording, (6,) [N, N m]; None for the model's pedestal.
        """
        return pedestal_wrench(self.tree) if tare is None else tare
