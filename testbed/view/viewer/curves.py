"""Signals and residuals over time, logged to Rerun."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import METHOD_LABELS
from testbed.view.viewer.colours import COLOURS, palette
from testbed.view.viewer.robot_drawing import clock
from testbed.view.viewer.scene import Scene, entity

INTERVAL_RATE = 25.0
"""Number of intervals per second with displayed minimum and maximum, about one per pixel [Hz]."""

MIN_INTERVAL_SAMPLES = 4
"""Smallest number of samples of an interval; with fewer samples all samples are displayed."""

MIN_LINE_WIDTH, LINE_WIDTH_STEP = 1.0, 1.4
"""Width of the top curve, and increment for each curve below it [points]."""


def log_signals(stream: rr.RecordingStream, scene: Scene, parent: str) -> None:
    """Log joint positions, and measured and predicted torques and wrench, over time.

    For identified drives, the friction torque of each joint according to its friction curve is
    logged, too.

    Args:
        stream: Stream of the recording.
        scene: The run.
        parent: Entity path of the run.
    """
    recording, drives, time = scene.run.recording, scene.run.drives, scene.motion.t
    names = scene.run.tree.names
    positions = dict(zip(names, recording.position.T, strict=True))
    log_series(
        stream, f"{parent}/position", recording.time, positions, palette(len(names))
    )
    for channel in scene.predictions.channels:
        path = entity(parent, channel)
        log_series(stream, path, time, channel.curves)
        if channel.kind == "torque" and drives is not None:
            curve, speed = (
                drives.curves[channel.index],
                scene.motion.qd[:, channel.index],
            )
            friction = {"friction": curve.torque_at_speed(speed)}
            log_series(stream, f"{path}/friction", time, friction, [COLOURS["path"]])


def log_residuals(stream: rr.RecordingStream, scene: Scene, parent: str) -> None:
    """Log low-pass filtered residuals `measured - predicted` of torques and wrench over time.

    Args:
        stream: Stream of the recording.
        scene: The run.
        parent: Entity path of the run.
    """
    for channel in scene.smoothed_predictions.channels:
        if residuals := channel.residuals:
            path = entity(f"{parent}/residual", channel)
            log_series(stream, path, scene.smoothed_predictions.motion.t, residuals)


def log_series(
    stream: rr.RecordingStream,
    path: str,
    time: Array,
    curves: Mapping[Any, Array],
    colours: Sequence[int] | NDArray[np.uint32] | None = None,
) -> None:
    """Log the curves of one plot over time, reduced to their extremes in time intervals.

    Args:
        stream: Stream of the recording.
        path: Entity path of the plot.
        time: Evenly spaced times, (M,) [s].
        curves: Values keyed by label, (M,) each.
        colours: Colours of the curves; default the colours of the labels in `COLOURS`. Earlier
            curves have wider lines, since later curves cover them.
    """
    widths = None
    if colours is None:
        colours = [COLOURS[label] for label in curves]
        widths = [
            MIN_LINE_WIDTH + LINE_WIDTH_STEP * rank
            for rank in reversed(range(len(curves)))
        ]
    labels = [METHOD_LABELS.get(label, label) for label in curves]
    lines = rr.SeriesLines(
        names=labels, colors=np.array(colours, np.uint32), widths=widths
    )
    stream.log(path, lines, static=True)
    send_values(
        stream, path, *interval_extremes(time, np.column_stack([*curves.values()]))
    )


def send_values(
    stream: rr.RecordingStream, path: str, time: Array, values: Array
) -> None:
    """Send the values of one plot over time.

    Args:
        stream: Stream of the recording.
        path: Entity path of the plot.
        time: Times, (M,) [s].
        values: Values of one curve, (M,), or of k curves, (M, k).
    """
    columns = rr.Scalars.columns(scalars=np.ascontiguousarray(values))
    stream.send_columns(path, indexes=[clock(time)], columns=columns)


def interval_extremes(time: Array, values: Array) -> tuple[Array, Array]:
    """Minima and maxima of signals in intervals of 1 / `INTERVAL_RATE`, in order of time.

    The two values are assigned to the ends of the interval, which is exact for monotonic signals.

    Args:
        time: Evenly spaced times, (M,) [s].
        values: Values, (M, k).

    Returns:
        Times, (N,), and values, (N, k), with two rows per interval; the inputs if an interval has
        fewer than `MIN_INTERVAL_SAMPLES` samples.
    """
    last = len(time) - 1
    size = int(last / max((time[-1] - time[0]) * INTERVAL_RATE, 1e-9) + 1e-9)
    if size < MIN_INTERVAL_SAMPLES:
        return time, values
    starts = np.arange(0, len(time), size)
    ends = np.minimum(starts + size - 1, last)
    intervals = values[np.minimum(starts[:, None] + np.arange(size), last)]
    indices = np.sort([intervals.argmin(axis=1), intervals.argmax(axis=1)], axis=0)
    extremes = np.take_along_axis(intervals, indices.swapaxes(0, 1), axis=1)
    return time[np.column_stack([starts, ends]).ravel()], extremes.reshape(
        -1, values.shape[1]
    )
