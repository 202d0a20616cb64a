"""Predicted wrench at the regression rows of a window, and the filter for rows.

The regressor columns of sensor errors are computed from the predicted wrench. It is evaluated at
fewer instants than there are samples, because the signals are slow after low-pass filtering.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.dynamics.force_derivatives import ForceDerivatives, force_derivatives
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class RowFilter:
    """Low-pass filter with decimation, from instants or samples to rows.

    Rows are the times at which the filtered signals enter the regression; instants are every
    `stride`-th sample. The filter has weights for J instants, or L samples, on either side of a
    row.

    Attributes:
        stride: Number of samples from one instant to the next.
        weights: Weights of the instants around a row, with sum one, (2 J + 1,).
        derivative_weights: Weights for the time derivative of a signal, (2 J + 1,) [1/s].
        row_step: Number of instants from one row to the next.
        sample_weights: Weights of all samples around a row, with sum one, (2 L + 1,).
        sample_derivative_weights: Weights of all samples for the time derivative, (2 L + 1,) [1/s].
    """

    stride: int
    weights: Array
    derivative_weights: Array
    row_step: int
    sample_weights: Array
    sample_derivative_weights: Array

    @property
    def half_width(self) -> int:
        """Half-length of the filter: number of samples from a row to its outermost instants."""
        return self.stride * (len(self.weights) // 2)


@dataclass(frozen=True, eq=False)
class PredictedWrench:
    """Motion in a window, and the wrench that an estimate predicts for its rows.

    Attributes:
        tree: The robot; only its geometry is used.
        gravity: Gravity vector in the bedplate frame, (3,) [m/s^2].
        theta: Barycentric parameters consistent with the estimate, (n, 10).
        motion: Motion at m instants; time is zero at the first instant.
        tare: Static wrench of the pedestal, (6,) [N, N m].
        time: Times of the rows, relative to the middle of the recording, (rows,) [s].
        filter: Filter from instants to rows.
        measured_samples: Samples of the plate around each row, minus the tare, (rows, 6, 2 L + 1)
            [N, N m].
    """

    tree: Tree
    gravity: Array
    theta: Array
    motion: Motion
    tare: Array
    time: Array
    filter: RowFilter
    measured_samples: Array

    @cached_property
    def measured_wrench(self) -> Array:
        """Filtered measured wrench at the rows, including the tare, (rows, 6) [N, N m]."""
        return self.measured_samples @ self.filter.sample_weights + self.tare

    @cached_property
    def measured_wrench_rate(self) -> Array:
        """Filtered time derivative of the measured wrench, (rows, 6) [N/s, N m/s]."""
        return self.measured_samples @ self.filter.sample_derivative_weights

    @cached_property
    def robot_wrench(self) -> Array:
        """Predicted wrench of the moving bodies at the instants, (m, 6) [N, N m]."""
        return self._derivatives.wrench

    @cached_property
    def wrench(self) -> Array:
        """Predicted wrench of robot and pedestal at the rows, (rows, 6) [N, N m]."""
        return self.filter_signals((self.robot_wrench + self.tare)[:, :, None])[..., 0]

    def coordinate_derivative(
        self, joint: int, dq: Array | float, dqd: Array | float, dqdd: Array | float
    ) -> Array:
        """Derivative of the wrench with respect to an error of one joint coordinate, (m, 6).

        The result is unfiltered, at the m instants, per unit of the error.

        Args:
            joint: Joint index.
            dq: Derivative of the joint position with respect to the error, (m,).
            dqd: Derivative of the joint velocity with respect to the error, (m,).
            dqdd: Derivative of the joint acceleration with respect to the error, (m,).
        """
        changes = (
            np.broadcast_to(each, self.motion.samples)[:, None, None]
            for each in (dq, dqd, dqdd)
        )
        joint_slopes = self._derivatives.wrench_slopes.select(slice(joint, joint + 1))
        return joint_slopes.force_changes(*changes)[:, :, 0, 0]

    def joint_time_derivative(self, joint: int) -> Array:
        """Time derivative of the wrench due to one joint's motion alone, filtered, (rows, 6, 1).

        The units are N/s and N m/s. Because the jerk is not measured, its term is integrated by
        parts, using the derivative of the filter.

        Args:
            joint: Joint index.
        """
        slopes = self._derivatives.wrench_slopes
        by_position, by_velocity, by_acceleration = (
            each[:, :, joint]
            for each in (slopes.position, slopes.velocity, slopes.acceleration)
        )
        qd, qdd = self.motion.qd[:, joint, None], self.motion.qdd[:, joint, None]
        acceleration_slope_rate = _time_derivative(by_acceleration, self.motion.t)
        terms_without_jerk = (
            by_position * qd + by_velocity * qdd - acceleration_slope_rate * qdd
        )
        return self.filter_signals(
            terms_without_jerk[..., None]
        ) + self.filter_derivatives((by_acceleration * qdd)[..., None])

    @cached_property
    def _derivatives(self) -> ForceDerivatives:
        """Predicted wrench at the instants, with derivatives in the joint coordinates."""
        return force_derivatives(self.tree, self.motion, self.theta, self.gravity)

    def filter_signals(self, signals: Array) -> Array:
        """Filter signals given at the instants, (m, 6, k), to obtain their rows, (rows, 6, k)."""
        return filtered(signals, self.filter.weights, self.filter.row_step)

    def filter_derivatives(self, signals: Array) -> Array:
        """Filtered time derivatives of signals, at the rows, (rows, 6, k)."""
        return filtered(signals, self.filter.derivative_weights, self.filter.row_step)


def filtered(signals: Array, weights: Array, step: int) -> Array:
    """Weighted sums of signals over consecutive instants, (rows, C, k).

    Args:
        signals: k signals of C channels at the m instants, (m, C, k).
        weights: Weights of the instants around a row, (2 J + 1,).
        step: Number of instants from one row to the next.
    """
    windows = np.lib.stride_tricks.sliding_window_view(signals, len(weights), axis=0)
    return windows[::step] @ weights


def _time_derivative(signal: Array, time: Array) -> Array:
    """Time derivative of smooth signals, (m, k), by fourth-order differences (second at ends)."""
    rate = np.gradient(signal, time, axis=0)
    if len(time) > 4:
        step = time[1] - time[0]
        inner, outer = signal[3:-1] - signal[1:-3], signal[4:] - signal[:-4]
        rate[2:-2] = (8 * inner - outer) / (12 * step)
    return rate
