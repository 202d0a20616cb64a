"""What is known of a robot before the data: its parameters, roughly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.parameters.symbols import barycentric, standard, to_barycentric
from testbed.core.robot.tree import Tree

MASS, REACH, LIGHT = 0.4, 0.03, 0.1
"""Relative sigma of masses, sigma of centres of mass [m]; and part of the robot's mass that a body
counts with at least: tools that the model does not know are at light links."""


@dataclass(frozen=True, eq=False)
class ScaledPrior:
    """Prior of the barycentric parameters: mean and root of the covariance.

    Attributes:
        tree: The robot, its masses roughly right.
    """

    tree: Tree

    @cached_property
    def mean(self) -> Array:
        """Barycentric parameters by the model file, (10 n,)."""
        return barycentric(self.tree).ravel()

    @cached_property
    def root(self) -> Array:
        """Root of their covariance, (10 n, 10 n): masses within a half, centres within some cm."""
        own = standard(self.tree)
        file, moments, tensor = own[:, :1], own[:, 1:4], own[:, 4:]
        mass = np.maximum(file, LIGHT * file.sum())
        centre = np.linalg.norm(moments, axis=1, keepdims=True) / np.where(
            file > 0, file, 1.0
        )
        reach = REACH + MASS * centre
        lever = np.repeat(mass * reach, 3, axis=1)
        sigma = np.hstack([MASS * mass, lever, MASS * np.abs(tensor) + mass * reach**2])
        sigma[: self.tree.massless] = 0.0
        spread = np.diag(sigma.ravel()).reshape(self.tree.n, 10, -1)
        return to_barycentric(self.tree, spread).reshape(sigma.size, -1)

    @property
    def weight(self) -> float:
        """Of the robot by the model file [N]."""
        mass = sum(each.mass for each in self.tree.inertias)
        return float(mass * np.linalg.norm(self.tree.gravity))

    def zero(self, tare: Array | None) -> Array:
        """What a plate shows without the robot, (6,) [N, N m].

        Args:
            tare: What its recording says; None for the model's pedestal.
        """
        return pedestal_wrench(self.tree) if tare is None else tare
