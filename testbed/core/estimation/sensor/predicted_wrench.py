"""What an estimate predicts near the rows of a window, and the filter on rows applied to it.

First-order effects of an instrument's faults are columns of the equations, too. They are made
of the predicted wrench, at fewer instants than there are samples: slow signals behind a low-pass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.dynamics.wrench_derivatives import base_wrench_derivatives
from testbed.core.estimation.regression.windows import TRANSITION, Plan, slope_weights
from testbed.core.kernel.numpy_engine import motion_of
from testbed.core.kernel.records import Signals
from testbed.core.robot.tree import Tree

INSTANTS_PER_CUTOFF = 10.0
"""Instants a second at which wrenches are predicted, per Hz of the filter on rows, at least.

So few fold the accelerations' noise into the columns: it is then another than that of the rows,
and a test does not take what both have in common for a fault."""

Change = Callable[[Array, Array, Array], tuple[Array | float, ...]]
"""Of a coordinate, its velocity and its acceleration, (m,) each, of which it is a function; numbers
where it is the same at all instants."""


@dataclass(frozen=True, eq=False)
class RowFilter:
    """The filter on rows at every so many samples.

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


def row_filter(plan: Plan, cutoff: float, *, exact: bool = False, noisy: float = 0.0) -> RowFilter:
    """The filter that a plan's rows pass.

    Args:
        plan: The rows.
        cutoff: Of the filter [Hz].
        exact: Whether wrenches are predicted at every sample: exactly as rows are filtered.
        noisy: Cutoff of another filter [Hz]: nothing that passes it is folded into the rows' band.
    """
    rate, middle = plan.source.rate, len(plan.weights) // 2
    unfolded = bool(noisy) * (1 + TRANSITION / 2) * (noisy + cutoff)
    least = rate if exact else max(INSTANTS_PER_CUTOFF * cutoff, unfolded)
    stride = max(
        d for d in range(1, plan.step + 1) if (plan.step % d == 0 and least * d <= rate) or d == 1
    )
    places = np.arange(-(middle // stride), middle // stride + 1) * stride
    weights = plan.weights[middle + places]
    slopes = slope_weights(plan.weights, places, rate)
    every = slope_weights(plan.weights, np.arange(-middle, middle + 1), rate)
    step = plan.step // stride
    return RowFilter(stride, weights / weights.sum(), slopes, step, plan.weights, every)


@dataclass(frozen=True, eq=False)
class PredictedWrench:
    """A window's motion, and the wrench that an estimate predicts, at instants around its rows.

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
        """The measured wrench, with the tare, at the rows, (rows, 6) [N, N m]."""
        return self.measured @ self.filter.every_weight + self.tare

    @cached_property
    def shown_rate(self) -> Array:
        """Its derivative in time, (rows, 6) [N/s, N m/s]."""
        return self.measured @ self.filter.every_slope

    @cached_property
    def moving(self) -> Array:
        """Wrench of the moving bodies, (m, 6) [N, N m]."""
        return self._derivatives[0]

    @cached_property
    def wrench(self) -> Array:
        """Wrench of robot and pedestal, (m, 6) [N, N m]."""
        return self.moving + self.tare

    def along(self, joint: int, change: Change) -> Array:
        """Derivative of the wrench by an error of one joint's coordinate, (m, 6).

        Args:
            joint: Index.
            change: How the coordinate moves with the error.
        """
        coordinate = (each[:, joint] for each in self._coordinates)
        found = np.zeros_like(self.moving)
        for by, slope in zip(change(*coordinate), self._derivatives[1][joint], strict=True):
            found += np.broadcast_to(by, len(found))[:, None] * slope
        return found

    def passing(self, joint: int) -> Array:
        """What one joint's motion alone changes of the wrench in time, filtered, (rows, 6, 1).

        Its jerk, which encoders do not measure, is left to the filter: by parts.

        Args:
            joint: Index.
        """
        by_position, by_velocity, by_acceleration = self._derivatives[1][joint]
        q, qd, qdd = (each[:, joint, None] for each in self._coordinates)
        del q
        turning = _rate(by_acceleration, self.motion.t)
        known = by_position * qd + by_velocity * qdd - turning * qdd
        return self.rows(known[..., None]) + self.rates((by_acceleration * qdd)[..., None])

    @property
    def _coordinates(self) -> tuple[Array, Array, Array]:
        return self.motion.q, self.motion.qd, self.motion.qdd

    @cached_property
    def _derivatives(self) -> tuple[Array, Array]:
        """That wrench, and its derivatives by each joint's coordinates, (n, 3, m, 6)."""
        return base_wrench_derivatives(self.tree, self.motion, self.theta, self.gravity)

    def rows(self, signals: Array) -> Array:
        """Signals at the instants, (m, 6, k), filtered at the rows, (rows, 6, k)."""
        return self._filtered(signals, self.filter.weights)

    def rates(self, signals: Array) -> Array:
        """Their derivatives in time, filtered, (rows, 6, k)."""
        return self._filtered(signals, self.filter.slopes)

    def _filtered(self, signals: Array, weights: Array) -> Array:
        windows = np.lib.stride_tricks.sliding_window_view(signals, len(weights), axis=0)
        return windows[:: self.filter.step] @ weights


def _rate(signal: Array, time: Array) -> Array:
    """Derivative of smooth signals, (m, k), by differences of order four; of two at the ends."""
    found = np.gradient(signal, time, axis=0)
    if len(time) > 4:
        step = time[1] - time[0]
        near, far = signal[3:-1] - signal[1:-3], signal[4:] - signal[:-4]
        found[2:-2] = (8 * near - far) / (12 * step)
    return found


def predict_wrench(
    plan: Plan, filtered: RowFilter, theta: Array, signals: Signals, first: int
) -> PredictedWrench:
    """What an estimate predicts of a window.

    Args:
        plan: The rows.
        filtered: The filter that they pass.
        theta: Barycentric parameters, (n, 10).
        signals: The window's.
        first: Number of its first row.
    """
    at = signals.start - filtered.reach
    count = ((signals.number - 1) * signals.step + 2 * filtered.reach) // filtered.stride + 1
    rate = plan.source.rate
    middle = (plan.source.samples - 1) / 2 / rate
    rows = (plan.reach + (first + np.arange(signals.number)) * plan.step) / rate - middle
    half, layout = len(signals.weights) // 2, plan.layout
    around = signals.measured[signals.start - half :]
    windows = np.lib.stride_tricks.sliding_window_view(around, 2 * half + 1, axis=0)
    return PredictedWrench(
        tree=layout.tree,
        gravity=layout.gravity,
        theta=theta,
        motion=motion_of(signals, at, count, filtered.stride, rate),
        tare=plan.tare,
        time=rows,
        filter=filtered,
        measured=windows[:: signals.step][: signals.number],
    )
