"""Filter on rows at a reduced rate, and prediction of a window's wrench."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.regression.windows import TRANSITION, Plan, slope_weights
from testbed.core.kernel.numpy_engine import window_motion
from testbed.core.kernel.records import SignalWindow
from testbed.sensors.predicted_wrench import PredictedWrench, RowFilter


def row_filter(
    plan: Plan, cutoff: float, *, exact: bool = False, position_cutoff: float = 0.0
) -> RowFilter:
    """Low-pass on rows at a reduced rate, with weights for values and time derivatives.

    The reduced rate is at least ten times the cutoff.

    Args:
        plan: Plan of the rows.
        cutoff: Cutoff of the filter on rows [Hz].
        exact: True to predict wrenches at every sample, filtered exactly as the rows.
        position_cutoff: Cutoff of the low-pass on positions [Hz]; the rate is high enough that
            noise below it is not aliased into the rows' band. Zero to allow aliasing.
    """
    rate, middle = plan.source.rate, len(plan.weights) // 2
    min_anti_alias_rate = (
        bool(position_cutoff) * (1 + TRANSITION / 2) * (position_cutoff + cutoff)
    )
    # Smallest rate of the predicted wrenches per Hz of the filter on rows. At so low a rate the
    # accelerations' noise is aliased into the columns and differs from the noise of the rows, so
    # that tests do not take common noise for a fault.
    min_rate = rate if exact else max(10.0 * cutoff, min_anti_alias_rate)
    stride = max(
        divisor
        for divisor in range(1, plan.step + 1)
        if (plan.step % divisor == 0 and min_rate * divisor <= rate) or divisor == 1
    )
    offsets = np.arange(-(middle // stride), middle // stride + 1) * stride
    weights = plan.weights[middle + offsets]
    slopes = slope_weights(plan.weights, offsets, rate)
    full_slopes = slope_weights(plan.weights, np.arange(-middle, middle + 1), rate)
    step = plan.step // stride
    return RowFilter(
        stride, weights / weights.sum(), slopes, step, plan.weights, full_slopes
    )


def window_prediction(
    plan: Plan, filtered: RowFilter, theta: Array, signals: SignalWindow, first: int
) -> PredictedWrench:
    """Predicted wrench of a window: motion, parameters, filter and measured samples.

    Args:
        plan: Plan of the rows.
        filtered: Filter on rows.
        theta: Barycentric parameters, (n, 10).
        signals: Signals of the window.
        first: Index of the window's first row.
    """
    start = signals.start - filtered.half_width
    count = (
        (signals.row_count - 1) * signals.step + 2 * filtered.half_width
    ) // filtered.stride + 1
    rate = plan.source.rate
    middle = (plan.source.samples - 1) / 2 / rate
    row_times = (
        plan.reach + (first + np.arange(signals.row_count)) * plan.step
    ) / rate - middle
    filter_reach, layout = len(signals.weights) // 2, plan.layout
    samples = signals.measured[signals.start - filter_reach :]
    windows = np.lib.stride_tricks.sliding_window_view(
        samples, 2 * filter_reach + 1, axis=0
    )
    return PredictedWrench(
        tree=layout.tree,
        gravity=layout.gravity,
        theta=theta,
        motion=window_motion(signals, start, count, filtered.stride, rate),
        tare=plan.tare,
        time=row_times,
        filter=filtered,
        measured_samples=windows[:: signals.step][: signals.row_count],
    )
