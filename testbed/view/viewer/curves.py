"""Curves over time and velocity as Rerun takes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import NAMES
from testbed.view.viewer.colours import COLOURS, Colour, palette
from testbed.view.viewer.drives import log_curve
from testbed.view.viewer.robot_drawing import clock
from testbed.view.viewer.scene import Scene, safe

BINS = 25.0
"""Parts of a second of which extremes are shown: a plot of ten seconds has as many pixels [Hz]."""

FEW = 4
"""Samples of such a part, of which fewer are all shown."""

MOST_POINTS = 2000
"""Points of a friction plot."""

THIN, THICKER = 1.0, 1.4
"""Width of a curve on top, and by how much one below another is wider [points]."""


def log_signals(stream: rr.RecordingStream, scene: Scene, at: str) -> None:
    """Positions; torques and wrench, measured and predicted; residuals, smoothed."""
    recording, inner = scene.run.recording, scene.motion.t
    names = scene.run.tree.names
    series(
        stream, f"{at}/position", recording.time, recording.position, names,
        palette(len(names)),
    )  # fmt: skip
    for signal in scene.predictions.signals:
        labels = ["measured", *signal.predicted]
        colours, widths = [COLOURS[label] for label in labels], layered(len(labels))
        for c, channel in enumerate(signal.channels):
            columns = [signal.measured[:, c], *(each[:, c] for each in signal.predicted.values())]
            path = f"{at}/{signal.kind}/{safe(channel)}"
            series(stream, path, inner, np.column_stack(columns), labels, colours, widths)
            if signal.kind == "torque" and scene.run.drives is not None:
                rubbed = scene.run.drives.curves[c].at(scene.motion.qd[:, c])
                series(
                    stream, f"{path}/friction", inner, rubbed[:, None], ["friction"],
                    [COLOURS["path"]],
                )  # fmt: skip
    time = scene.smooth.motion.t
    for signal in scene.smooth.signals:
        for c, channel in enumerate(signal.channels if signal.predicted else ()):
            rest = np.column_stack([signal.residual(m)[:, c] for m in signal.predicted])
            path = f"{at}/residual/{signal.kind}/{safe(channel)}"
            colours = [COLOURS[method] for method in signal.predicted]
            methods = list(signal.predicted)
            series(stream, path, time, rest, methods, colours, layered(len(methods)))


def layered(count: int) -> list[float]:
    """Widths of curves that may lie on each other: each is wider than those over it.

    Args:
        count: Of curves.
    """
    return [THIN + THICKER * over for over in reversed(range(count))]


def series(
    stream: rr.RecordingStream,
    path: str,
    time: Array,
    values: Array,
    labels: Sequence[str],
    colours: Sequence[Colour],
    widths: Sequence[float] | None = None,
) -> None:
    """Curves of one plot over time.

    Args:
        stream: Where to.
        path: The plot's place among the entities.
        time: (M,) [s].
        values: (M, k).
        labels: (k,).
        colours: (k,).
        widths: Of the lines, (k,); default the viewer's.
    """
    lines = rr.SeriesLines(
        names=[NAMES.get(x, x) for x in labels], colors=list(colours), widths=widths
    )
    stream.log(path, lines, static=True)
    instants, shown = thinned(time, values)
    columns = rr.Scalars.columns(scalars=np.ascontiguousarray(shown))
    stream.send_columns(path, indexes=[clock(instants)], columns=columns)


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
    return time[np.column_stack([starts, ends]).ravel()], shown.reshape(-1, values.shape[1])


def log_friction(stream: rr.RecordingStream, scene: Scene, at: str) -> None:
    """Unexplained torque against velocity, and the friction found; a picture a joint.

    Both axes are drawn from -1 to 1; their ticks say the true values.
    """
    rest = scene.predictions.unexplained_torque
    if rest is None:
        return
    step = max(1, len(rest) // MOST_POINTS)
    for j, joint in enumerate(scene.run.tree.joints):
        width, height = scene.friction_axes(j)
        points = np.column_stack(
            [scene.motion.qd[::step, j] / width, -rest[::step, j] / height]  # y points down
        )
        path = f"{at}/{safe(joint.name)}"
        dots = rr.Points2D(points, colors=[COLOURS["measured"]], radii=[0.006])
        stream.log(f"{path}/points", dots, static=True)
        units = ("rad/s", "N m") if joint.revolute else ("m/s", "N")
        _log_axes(stream, f"{path}/axes", (width, height), units)
        grid = np.zeros((201, scene.run.tree.n))
        grid[:, j] = np.linspace(-width, width, 201)
        curve = scene.predictions.friction(grid)
        if curve is not None:
            line = np.column_stack([grid[:, j] / width, -curve[:, j] / height])
            strip = rr.LineStrips2D([line], colors=[COLOURS["internal"]], radii=[0.008])
            stream.log(f"{path}/curve", strip, static=True)
        if scene.run.drives is not None:
            log_curve(stream, path, scene.run.drives.curves[j], (width, height))


def _log_axes(
    stream: rr.RecordingStream, path: str, ends: tuple[float, float], units: tuple[str, str]
) -> None:
    """Two axes that cross at zero, with ticks at round values and what they mean."""
    strips, places, labels = [[[-1.1, 0.0], [1.1, 0.0]], [[0.0, 1.1], [0.0, -1.1]]], [], []
    for axis, (end, unit) in enumerate(zip(ends, units, strict=True)):
        round_value = tick(end)
        for value in (-round_value, round_value):
            place = [value / end, 0.0] if axis == 0 else [0.0, -value / end]
            across = [0.0, 0.03] if axis == 0 else [0.03, 0.0]
            strips.append([[p - a for p, a in zip(place, across, strict=True)],
                           [p + a for p, a in zip(place, across, strict=True)]])  # fmt: skip
            places.append(place)
            labels.append(f"{value:g} {unit}")
    lines = rr.LineStrips2D(strips, colors=[COLOURS["axis"]], radii=[0.003])
    stream.log(path, lines, static=True)
    ticks = rr.Points2D(
        places, colors=[COLOURS["axis"]], radii=[0.001], labels=labels, show_labels=True
    )
    stream.log(f"{path}/ticks", ticks, static=True)


def tick(end: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that an axis still reaches."""
    power = 10.0 ** np.floor(np.log10(end))
    return float(max(step * power for step in (1, 2, 5) if step * power <= end * (1 + 1e-9)))
