"""Figures as SVG that takes its colours from the page: text stays text, nothing is fetched."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from testbed.arrays import Array

INK, FAINT = "#010203", "#010204"
"""Stand for the page's text colour and a fainter one."""
COLOURS = {
    "measured": "#010205",
    "external": "#010206",
    "internal": "#010207",
    "truth": "#010208",
}
_VARIABLES = {
    INK: "var(--ink)",
    FAINT: "var(--faint)",
    "#010205": "var(--measured)",
    "#010206": "var(--external)",
    "#010207": "var(--internal)",
    "#010208": "var(--truth)",
}
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "testbed",
    "font.family": "sans-serif",
    "font.size": 9,
    "text.color": INK,
    "text.parse_math": False,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.titlesize": 9,
    "axes.titlecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": FAINT,
    "grid.alpha": 0.35,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "path.simplify": True,
    "path.simplify_threshold": 0.6,
}

Curves = Mapping[str, tuple[Array, Array]]  # x and y by what they are: measured, external, ...


def panels(
    titles: Sequence[str],
    curves: Sequence[Curves],
    x_label: str,
    y_labels: Sequence[str],
    *,
    points: Sequence[str] = (),
    log: bool = False,
    columns: int = 2,
    name: str,
) -> str:
    """Small plots of one kind, one a channel, as one SVG.

    Args:
        titles: One a panel.
        curves: One a panel.
        x_label: Of all panels, with unit.
        y_labels: One a panel, with unit.
        points: Which curves are drawn as points.
        log: Both axes logarithmic.
        columns: Panels in a row.
        name: What the figure shows, for those who cannot see it.
    """
    rows = -(-len(titles) // columns)
    with rc_context(_STYLE):
        figure = Figure(figsize=(7.2, 1.9 * rows + 0.4), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
        for k, axis in enumerate(axes.flat):
            if k >= len(titles):
                axis.set_visible(False)
                continue
            for label, (x, y) in curves[k].items():
                if label in points:
                    axis.plot(x, y, ".", color=COLOURS[label], markersize=2, label=label)
                else:
                    axis.plot(x, y, color=COLOURS[label], label=label)
            axis.set_title(titles[k], loc="left")
            axis.set_ylabel(y_labels[k])
            if log:
                axis.set_xscale("log")
                axis.set_yscale("log")
            if k >= len(titles) - columns:
                axis.set_xlabel(x_label)
        handles, labels = axes.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
        return _svg(figure, name)


def _svg(figure: Figure, name: str) -> str:
    """The figure as an element of a page."""
    text = io.StringIO()
    canvas: Any = FigureCanvasSVG(figure)
    canvas.print_svg(text, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    for colour, variable in _VARIABLES.items():
        svg = svg.replace(colour, variable)
    svg = re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', "", svg, count=1)
    title = f'role="img" aria-label="{name}">'
    return svg.replace(">", f" {title}", 1)


def thinned(x: Array, y: Array, most: int = 1500) -> tuple[Array, Array]:
    """At most so many points of a curve, evenly taken."""
    step = max(1, -(-len(x) // most))
    return x[::step], y[::step]


def spectrum(signal: Array, rate: float, size: int = 2048) -> tuple[Array, Array]:
    """Amplitude density of a signal over frequency [Hz], [unit/sqrt(Hz)]: Welch's means.

    Args:
        signal: (M,).
        rate: Samples a second [Hz].
        size: Samples of a segment; half of it overlaps, Hann's window.
    """
    size = min(size, len(signal))
    window = np.hanning(size)
    starts = range(0, len(signal) - size + 1, max(1, size // 2))
    parts = np.array([signal[s : s + size] - signal[s : s + size].mean() for s in starts])
    power = np.mean(np.abs(np.fft.rfft(parts * window)) ** 2, axis=0)
    density: Array = np.sqrt(2 * power / (rate * np.sum(window**2)))
    return np.asarray(np.fft.rfftfreq(size, 1 / rate)[1:], dtype=np.float64), density[1:]
