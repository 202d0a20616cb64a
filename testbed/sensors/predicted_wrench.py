"""Wrench that an estimate predicts around the rows of a window, and the filter on rows.

Regressor columns of sensor errors are made of the predicted wrench, at fewer instants than there
are samples: slow signals behind a low-pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.dynamics.force_derivatives import (
    ForceDerivatives,
    force_derivatives,
)
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class RowFilter:
    """Filter on rows at every so many samples.

    Attributes:
        stride: Samples from one instant to the next.
        weights: Of the instants around a row, (2 J + 1,), of sum one.
        slopes: The same for a signal's derivative in time, (2 J + 1,) [1/s].
        step: Instants from row to row.
        every_weight: Weights of every sample around a row, (2 L + 1,), of sum one.
        every_slope: Slopes at every sample, (2 L + 1,) [1/s].
    """

    stride: int
    weights: Array
    slopes: Array
    step: int
    every_weight: Array
    every_slope: Array

    @property
    def reach(self) -> int:
        """Samples that the instants lie to either side of a row."""
        return self.stride * (len(self.weights) // 2)


@dataclass(frozen=True, eq=False)
class PredictedWrench:
    """Motion of a window, and the wrench that an estimate predicts, at instants around its rows.

    Attributes:
        tree: The robot; only its geometry matters.
        gravity: (3,) [m/s^2], bedplate frame.
        theta: Barycentric parameters that the estimate allows, (n, 10).
        motion: At m instants; its time begins at the first.
        tare: Static wrench of the pedestal, (6,) [N, N m].
        time: Of the rows, from the middle of the recording, (rows,) [s].
        filter: From instants to rows.
        measured: The plate's samples around each row, without the tare, (rows, 6, 2 L + 1)
            [N, N m].
    """

    tree: Tree
    gravity: Array
    theta: Array
    motion: Motion
    tare: Array
    time: Array
    filter: RowFilter
    measured: Array

    @cached_property
    def shown(self) -> Array:
        """Measured wrench, with the tare, at the rows, (rows, 6) [N, N m]."""
        return self.measured @ self.filter.every_weight + self.tare

    @cached_property
    def shown_rate(self) -> Array:
        """Derivative of the measured wrench in time, (rows, 6) [N/s, N m/s]."""
        return self.measured @ self.filter.every_slope

    @cached_property
    def moving(self) -> Array:
        """Wrench of the moving bodies, (m, 6) [N, N m]."""
        return self._derivatives.wrench

    @cached_property
    def wrench(self) -> Array:
        """Wrench of robot and pedestal at the rows, (rows, 6) [N, N m]."""
        return self.rows((self.moving + self.tare)[:, :, None])[..., 0]

    def along(
        self, joint: int, dq: Array | float, dqd: Array | float, dqdd: Array | float
    ) -> Array:
        """Derivative of the wrench by an error of one joint's coordinate, (m, 6).

        Args:
            joint: Index.
            dq: Derivative of the coordinate by the error, (m,).
            dqd: Derivative of the velocity by the error, (m,).
            dqdd: Derivative of the acceleration by the error, (m,).
        """
        changes = (
            np.broadcast_to(each, self.motion.samples)[:, None, None]
            for each in (dq, dqd, dqdd)
        )
        own = self._derivatives.wrench_slopes.of(slice(joint, joint + 1))
        return own.along(*changes)[:, :, 0, 0]

    def passing(self, joint: int) -> Array:
        """Derivative of the wrench in time by one joint's motion alone, filtered, (rows, 6, 1).

        Encoders do not measure the jerk: the filter differentiates, by parts.

        Args:
            joint: Index.
        """
        slopes = self._derivatives.wrench_slopes
        by_position, by_velocity, by_acceleration = (
            each[:, :, joint]
            for each in (slopes.position, slopes.velocity, slopes.acceleration)
        )
        qd, qdd = self.motion.qd[:, joint, None], self.motion.qdd[:, joint, None]
        turning = _rate(by_acceleration, self.motion.t)
        known = by_position * qd + by_velocity * qdd - turning * qdd
        return self.rows(known[..., None]) + self.rates(
            (by_acceleration * qdd)[..., None]
        )

    @cached_property
    def _derivatives(self) -> ForceDerivatives:
        return force_derivatives(self.tree, self.motion, self.theta, self.gravity)

    def rows(self, signals: Array) -> Array:
        """Signals at the instants, (m, 6, k), filtered at the rows, (rows, 6, k)."""
        return filtered(signals, self.filter.weights, self.filter.step)

    def rates(self, signals: Array) -> Array:
        """Derivatives of signals in time, filtered at the rows, (rows, 6, k)."""
        return filtered(signals, self.filter.slopes, self.filter.step)


def filtered(signals: Array, weights: Array, step: int) -> Array:
    """Weighted sums of consecutive instants, (rows, C, k), of signals (m, C, k).

    Args:
        signals: At instants.
        weights: Of the instants around a row.
        step: Instants from row to row.
    """
    windows = np.lib.stride_tricks.sliding_window_view(signals, len(weights), axis=0)
    return windows[::step] @ weights


def _rate(signal: Array, time: Array) -> Array:
    """Derivative of smooth signals, (m, k), by differences of order four; of two at the ends."""
    rate = np.gradient(signal, time, axis=0)
    if len(time) > 4:
        step = time[1] - time[0]
        near, far = signal[3:-1] - signal[1:-3], signal[4:] - signal[:-4]
        rate[2:-2] = (8 * near - far) / (12 * step)
    return rate
