"""Curves over time as Rerun takes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import NAMES
from testbed.view.viewer.colours import COLOURS, palette
from testbed.view.viewer.robot_drawing import clock
from testbed.view.viewer.scene import Scene, entity

BINS = 25.0
"""Parts of a second of which extremes are shown: a plot of ten seconds has as many pixels [Hz]."""

FEW = 4
"""Samples of such a part, of which fewer are all shown."""

THIN, THICKER = 1.0, 1.4
"""Width of a curve on top, and by how much one below another is wider [points]."""


def log_signals(stream: rr.RecordingStream, scene: Scene, at: str) -> None:
    """Positions; torques and wrench, measured and predicted."""
    recording, drives, time = scene.run.recording, scene.run.drives, scene.motion.t
    names = scene.run.tree.names
    positions = dict(zip(names, recording.position.T, strict=True))
    log_series(stream, f"{at}/position", recording.time, positions, palette(len(names)))
    for channel in scene.predictions.channels:
        path = entity(at, channel)
        log_series(stream, path, time, channel.curves)
        if channel.kind == "torque" and drives is not None:
            curve, speed = (
                drives.curves[channel.index],
                scene.motion.qd[:, channel.index],
            )
            friction = {"friction": curve.at(speed)}
            log_series(stream, f"{path}/friction", time, friction, [COLOURS["path"]])


def log_residuals(stream: rr.RecordingStream, scene: Scene, at: str) -> None:
    """Residuals of torques and wrench, smoothed."""
    for channel in scene.smooth.channels:
        if residuals := channel.residuals:
            path = entity(f"{at}/residual", channel)
            log_series(stream, path, scene.smooth.motion.t, residuals)


def log_series(
    stream: rr.RecordingStream,
    path: str,
    time: Array,
    curves: Mapping[Any, Array],
    colours: Sequence[int] | NDArray[np.uint32] | None = None,
) -> None:
    """Curves of one plot over time.

    Args:
        stream: Where to.
        path: The plot's place among the entities.
        time: (M,) [s].
        curves: By label, (M,) each.
        colours: One a curve; default those of the labels, where each line is wider than those
            over it.
    """
    widths = None
    if colours is None:
        colours = [COLOURS[label] for label in curves]
        widths = [THIN + THICKER * over for over in reversed(range(len(curves)))]
    labels = [NAMES.get(label, label) for label in curves]
    lines = rr.SeriesLines(
        names=labels, colors=np.array(colours, np.uint32), widths=widths
    )
    stream.log(path, lines, static=True)
    send_values(stream, path, *thinned(time, np.column_stack([*curves.values()])))


def send_values(
    stream: rr.RecordingStream, path: str, time: Array, values: Array
) -> None:
    """Values of one plot over time.

    Args:
        stream: Where to.
        path: The plot's place among the entities.
        time: (M,) [s].
        values: (M,) of one curve, (M, k) of k curves.
    """
    columns = rr.Scalars.columns(scalars=np.ascontiguousarray(values))
    stream.send_columns(path, indexes=[clock(time)], columns=columns)


def thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """The least and the largest value of each part of the time, in the order in which they come.

    They stand at the part's ends, where those of a rising or a falling curve are.

    Args:
        time: Evenly spaced, (M,) [s].
        values: (M, k).

    Returns:
        Instants, (N,), and values, (N, k); what was given, where it is not faster.
    """
    last = len(time) - 1
    size = int(last / max((time[-1] - time[0]) * BINS, 1e-9) + 1e-9)
    if size < FEW:
        return time, values
    starts = np.arange(0, len(time), size)
    ends = np.minimum(starts + size - 1, last)
    parts = values[np.minimum(starts[:, None] + np.arange(size), last)]
    places = np.sort([parts.argmin(axis=1), parts.argmax(axis=1)], axis=0)
    shown = np.take_along_axis(parts, places.swapaxes(0, 1), axis=1)
    return time[np.column_stack([starts, ends]).ravel()], shown.reshape(
        -1, values.shape[1]
    )
