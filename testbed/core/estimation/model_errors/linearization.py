"""Motion and predicted forces at instants, about which model errors are linear."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import convolve1d

from testbed.core.base.arrays import Array
from testbed.core.dynamics.force_derivatives import ForceDerivatives, ForceSlopes
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.estimate import Method
from testbed.core.estimation.model_errors.estimates import Sizes
from testbed.core.estimation.regression.windows import ROW_ATTENUATION, low_pass
from testbed.core.robot.tree import Tree
from testbed.sensors.predicted_wrench import RowFilter, filtered

QUASI_STATIC = 4.0
"""Cutoff of forces that deform [Hz]: structures follow slower ones without delay."""


@dataclass(frozen=True, eq=False)
class Linearization:
    """Motion of a window, the forces that an estimate predicts, and their derivatives.

    Attributes:
        tree: The robot; only its geometry matters.
        method: Whether torques or the wrench are measured.
        motion: At m instants.
        forces: Wrench, torques, and their derivatives; by frames where the base is fixed.
        joint_torque: Of the joints' own terms, (m, n) [N m or N].
        time: From the middle of the recording, (m,) [s].
        sizes: Of the recording.
        filter: From instants to rows.
    """

    tree: Tree
    method: Method
    motion: Motion
    forces: ForceDerivatives
    joint_torque: Array
    time: Array
    sizes: Sizes
    filter: RowFilter

    @property
    def with_frames(self) -> bool:
        """Whether there are derivatives by frames and base."""
        slopes = self.forces.wrench_slopes.position
        return bool(slopes.shape[2] > self.tree.n)

    @property
    def slopes(self) -> ForceSlopes:
        """Derivatives of what is measured."""
        external = self.method == "external"
        return self.forces.wrench_slopes if external else self.forces.torque_slopes

    @cached_property
    def sense(self) -> Array:
        """Smooth sign of the velocities, (m, n)."""
        qd = self.motion.qd
        return np.asarray(qd / np.sqrt(qd**2 + (0.01 * self.sizes.speed) ** 2))

    @cached_property
    def total_torque(self) -> Array:
        """Torques of bodies and joint terms, (m, n) [N m or N]."""
        return np.asarray(self.forces.torque + self.joint_torque)

    def slow(self, signal: Array) -> Array:
        """Signal, (m, k), through a low-pass below QUASI_STATIC."""
        rate = 1 / float(self.motion.t[1] - self.motion.t[0])
        weights = low_pass(rate, QUASI_STATIC, ROW_ATTENUATION)
        return np.asarray(convolve1d(signal, weights, axis=0, mode="nearest"))

    def rate(self, signal: Array) -> Array:
        """Derivative in time of a signal, (m, ...), by central differences."""
        return np.asarray(np.gradient(signal, self.motion.t, axis=0))

    def displaced(self, first: int, displacements: Array) -> Array:
        """Changes of what is measured by displacements in time, (m, C, D, k).

        Args:
            first: The first of D displacements among those of the derivatives.
            displacements: (m, D, k) [rad or m].
        """
        rate = self.rate(displacements)
        slopes = self.slopes.of(slice(first, first + displacements.shape[1]))
        return slopes.along(displacements, rate, self.rate(rate))

    def encoders(self, displacements: Array) -> Array:
        """The same of joints, each by itself, (m, C, n k).

        Args:
            displacements: (m, n, k) [rad or m].
        """
        change = self.displaced(0, displacements)
        return change.reshape(*change.shape[:2], -1)

    def rows(self, signals: Array) -> Array:
        """Signals at the instants, (m, C, k), filtered at the rows, (C, rows, k)."""
        found = filtered(signals, self.filter.weights, self.filter.step)
        return found.transpose(1, 0, 2)
