"""Filter on the rows of a plan, and the wrench that an estimate predicts of a window."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.regression.windows import TRANSITION, Plan, slope_weights
from testbed.core.kernel.numpy_engine import motion_of
from testbed.core.kernel.records import Signals
from testbed.sensors.predicted_wrench import PredictedWrench, RowFilter


def row_filter(
    plan: Plan, cutoff: float, *, exact: bool = False, noisy: float = 0.0
) -> RowFilter:
    """The filter that a plan's rows pass.

    Args:
        plan: The rows.
        cutoff: Of the filter [Hz].
        exact: Whether wrenches are predicted at every sample: exactly as rows are filtered.
        noisy: Cutoff of another filter [Hz]: nothing that passes it is folded into the rows' band.
    """
    rate, middle = plan.source.rate, len(plan.weights) // 2
    unfolded = bool(noisy) * (1 + TRANSITION / 2) * (noisy + cutoff)
    # instants a second at which wrenches are predicted, per Hz of the filter on rows, at least. So
    # few fold the accelerations' noise into the columns: it is then another than that of the rows,
    # and a test does not take what both have in common for a fault
    least = rate if exact else max(10.0 * cutoff, unfolded)
    stride = max(
        d
        for d in range(1, plan.step + 1)
        if (plan.step % d == 0 and least * d <= rate) or d == 1
    )
    places = np.arange(-(middle // stride), middle // stride + 1) * stride
    weights = plan.weights[middle + places]
    slopes = slope_weights(plan.weights, places, rate)
    every = slope_weights(plan.weights, np.arange(-middle, middle + 1), rate)
    step = plan.step // stride
    return RowFilter(stride, weights / weights.sum(), slopes, step, plan.weights, every)


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
    count = (
        (signals.number - 1) * signals.step + 2 * filtered.reach
    ) // filtered.stride + 1
    rate = plan.source.rate
    middle = (plan.source.samples - 1) / 2 / rate
    rows = (
        plan.reach + (first + np.arange(signals.number)) * plan.step
    ) / rate - middle
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
