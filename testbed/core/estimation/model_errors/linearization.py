"""Motion and predicted forces about which model errors are linearised."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import convolve1d

from testbed.core.base.arrays import Array
from testbed.core.dynamics.force_derivatives import ForceDerivatives, ForceGradients
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.model_errors.estimates import SignalSizes
from testbed.core.estimation.regression.windows import ROW_ATTENUATION, low_pass
from testbed.core.parameters.rules import Signal
from testbed.core.robot.tree import Tree
from testbed.sensors.predicted_wrench import RowFilter, filtered

QUASI_STATIC_CUTOFF = 4.0
"""Cutoff of forces that deform structures [Hz]: slower deformation follows without delay."""


@dataclass(frozen=True, eq=False)
class Linearization:
    """Motion of a window, forces that an estimate predicts, and their derivatives.

    Attributes:
        tree: Kinematic tree of the robot; only its geometry is used.
        method: Measured signal: torques or wrench.
        motion: Motion at m instants.
        forces: Wrench, torques, and their derivatives with respect to joint displacements; also
            with respect to displacements of joint frames and base, if the base is fixed and no
            force sensor is in the robot.
        joint_torque: Torques of the joint terms (friction, rotors), (m, n) [N m or N].
        time: Time from the middle of the recording, (m,) [s].
        sizes: Signal magnitudes of the recording.
        filter: Filter from instants to rows.
    """

    tree: Tree
    method: Signal
    motion: Motion
    forces: ForceDerivatives
    joint_torque: Array
    time: Array
    sizes: SignalSizes
    filter: RowFilter

    @property
    def has_frame_derivatives(self) -> bool:
        """True if derivatives with respect to joint frames and base are available."""
        slopes = self.forces.wrench_slopes.position
        return bool(slopes.shape[2] > self.tree.n)

    @property
    def slopes(self) -> ForceGradients:
        """Derivatives of the measured signal with respect to the displacements of `forces`."""
        is_wrench = self.method == "wrench"
        return self.forces.wrench_slopes if is_wrench else self.forces.torque_slopes

    @cached_property
    def smooth_sign(self) -> Array:
        """Smooth sign of the joint velocities, (m, n), linear below 1 % of the greatest speed."""
        qd = self.motion.qd
        return np.asarray(qd / np.sqrt(qd**2 + (0.01 * self.sizes.speed) ** 2))

    @cached_property
    def total_torque(self) -> Array:
        """Torques of bodies and joint terms, (m, n) [N m or N]."""
        return np.asarray(self.forces.torque + self.joint_torque)

    def quasi_static_part(self, signal: Array) -> Array:
        """Low-passed part of a signal below QUASI_STATIC_CUTOFF, (m, k).

        Args:
            signal: Signal at the instants, (m, k).
        """
        rate = 1 / float(self.motion.t[1] - self.motion.t[0])
        weights = low_pass(rate, QUASI_STATIC_CUTOFF, ROW_ATTENUATION)
        return np.asarray(convolve1d(signal, weights, axis=0, mode="nearest"))

    def time_derivative(self, signal: Array) -> Array:
        """Time derivative of a signal by central differences, (m, ...)."""
        return np.asarray(np.gradient(signal, self.motion.t, axis=0))

    def displacement_effects(self, first: int, displacements: Array) -> Array:
        """Changes of the measured signal due to time-varying displacements, (m, C, D, k).

        They include the effects of the displacements' first and second time derivatives, which are
        finite differences.

        Args:
            first: Index of the first of D displacements in the order of `ForceDerivatives`: n joint
                displacements, five per joint frame, and six of the base.
            displacements: Displacements, (m, D, k) [rad or m].
        """
        rate = self.time_derivative(displacements)
        slopes = self.slopes.select(slice(first, first + displacements.shape[1]))
        return slopes.force_changes(displacements, rate, self.time_derivative(rate))

    def encoder_effects(self, displacements: Array) -> Array:
        """Changes of the measured signal due to displacements of each joint alone, (m, C, n k).

        Columns are ordered by joint, then by displacement.

        Args:
            displacements: Joint displacements, (m, n, k) [rad or m].
        """
        change = self.displacement_effects(0, displacements)
        return change.reshape(*change.shape[:2], -1)

    def filtered_rows(self, signals: Array) -> Array:
        """Filter signals at the instants, (m, C, k), to signals at the rows, (C, rows, k)."""
        rows = filtered(signals, self.filter.weights, self.filter.row_step)
        return rows.transpose(1, 0, 2)
