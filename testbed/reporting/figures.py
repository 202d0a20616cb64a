"""Figures as SVG that takes its colours from the page: text stays text, nothing is fetched."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from testbed.arrays import Array

INK, FAINT = "#010203", "#010204"
"""Stand for the page's text colour and a fainter one."""
COLOURS = {
    "measured": "#010205",
    "external": "#010206",
    "internal": "#010207",
    "unexplained": "#010205",
}
_VARIABLES = {
    INK: "var(--ink)",
    FAINT: "var(--faint)",
    "#010205": "var(--measured)",
    "#010206": "var(--external)",
    "#010207": "var(--internal)",
}
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "text.color": INK,
    "text.parse_math": False,  # a joint's name may hold what looks like mathematics
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.titlesize": 9,
    "axes.titlecolor": INK,
    "axes.titlepad": 3,
    "axes.xmargin": 0.02,
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
WIDTH, HEIGHT = 4.1, 1.85
"""Of a plot [inches]."""
_MARGINS = {"left": 0.115, "right": 0.985, "bottom": 0.245, "top": 0.89}  # parts of it
WIDER = 1.05
"""Room for labels in a font wider than the one they are measured in."""
_WIDTHS = {"measured": 2.6}  # what hides behind the predictions

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

Curves = Mapping[str, tuple[Array, Array]]  # x and y by what they are: measured, external, ...


@dataclass(frozen=True, eq=False)
class Panel:
    """One small plot.

    Attributes:
        title: What it shows, with unit.
        curves: By what they are: "measured", "external", "internal" or "unexplained".
        x_label: With unit.
        log: Both axes logarithmic.
        points: Which curves are drawn as points.
        bars: Half the length of the error bars of points, by curve.
        bands: Half the width of the band around a line, by curve.
        whole: Whether the horizontal axis counts.
    """

    title: str
    curves: Curves
    x_label: str
    log: bool = False
    points: tuple[str, ...] = ()
    bars: Mapping[str, Array] = field(default_factory=dict)
    bands: Mapping[str, Array] = field(default_factory=dict)
    whole: bool = False

    @property
    def svg(self) -> str:
        """The plot as an element of a page."""
        with rc_context(STYLE | {"svg.hashsalt": f"{self.title} {self.x_label}"}):
            figure = Figure(figsize=(WIDTH, HEIGHT))
            axis = figure.subplots()
            figure.subplots_adjust(**_MARGINS)
            for label, (x, y) in self.curves.items():
                style: dict[str, Any] = {"color": COLOURS[label]}
                if label in self.points:
                    size = 7 if label in self.bars else 2
                    style |= {"linestyle": "none", "marker": ".", "markersize": size}
                else:
                    style |= {"linewidth": _WIDTHS.get(label, 1.1)}
                axis.plot(x, y, **style)
                if label in self.bars:
                    at, height = np.asarray(x), np.asarray(self.bars[label])
                    axis.vlines(at, y - height, y + height, color=COLOURS[label], linewidth=1.1)
                if label in self.bands:
                    wide = np.asarray(self.bands[label])
                    colour = COLOURS[label]
                    axis.fill_between(x, y - wide, y + wide, color=colour, alpha=0.3, linewidth=0)
            axis.set_title(self.title, loc="left")
            axis.set_xlabel(self.x_label, labelpad=3)
            drawn = any((np.asarray(line.get_ydata()) > 0).any() for line in axis.lines)
            (_logarithmic if self.log and drawn else _linear)(axis)
            if self.whole:
                axis.xaxis.set_major_locator(MaxNLocator(6, integer=True))
                axis.margins(x=0.1, y=0.1)
            figure.subplots_adjust(left=max(_MARGINS["left"], WIDER * labels_room(figure, axis)))
            return as_svg(figure, self.title)


def labels_room(figure: Figure, axis: Axes) -> float:
    """What the labels of the vertical axis need, part of the figure's width."""
    canvas: Any = FigureCanvasAgg(figure)
    box = axis.yaxis.get_tightbbox(canvas.get_renderer())
    return 0.0 if box is None else float((axis.bbox.x0 - box.x0) / figure.bbox.width)


def _linear(axis: Axes) -> None:
    """Few round ticks."""
    for scale, most in ((axis.xaxis, 6), (axis.yaxis, 4)):
        scale.set_major_locator(MaxNLocator(most, steps=[1, 2, 5, 10]))
        scale.set_major_formatter(FuncFormatter(lambda value, _: tick_label(value)))


def _logarithmic(axis: Axes) -> None:
    """Both axes, with powers of ten for ticks; the vertical one from one of them to another."""
    axis.set_xscale("log")
    axis.set_yscale("log")
    shown = [line.get_ydata() for line in axis.lines]
    positive = np.concatenate([np.asarray(y)[np.asarray(y) > 0] for y in shown])
    low, high = np.floor(np.log10(positive.min())), np.ceil(np.log10(positive.max()))
    axis.set_ylim(10.0**low, 10.0 ** max(high, low + 1))
    for scale, most in ((axis.xaxis, 6), (axis.yaxis, 4)):
        scale.set_major_locator(LogLocator(numticks=most))
        scale.set_major_formatter(FuncFormatter(lambda value, _: power_of_ten(value)))
        scale.set_minor_formatter(NullFormatter())


def tick_label(value: float) -> str:
    """A tick of an even axis: 0.02, -150, and 2·10⁻⁵ where zeros would be counted."""
    number, _, power = f"{value:g}".partition("e")
    if power:
        number += f"·10{str(int(power)).translate(_SUPERSCRIPTS)}"
    return number.replace("-", "−")


def power_of_ten(value: float) -> str:
    """A tick of a logarithmic axis: 0.01, 1, 100, and 10⁻⁵ where zeros would be counted."""
    power = round(float(np.log10(value)))
    if -3 <= power <= 3:
        return f"{10.0**power:g}"
    return f"10{str(power).translate(_SUPERSCRIPTS)}"


def as_svg(figure: Figure, name: str) -> str:
    """The figure as an element of a page, named for those who do not see it."""
    text = io.StringIO()
    canvas: Any = FigureCanvasSVG(figure)
    canvas.print_svg(text, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    for colour, variable in _VARIABLES.items():
        svg = svg.replace(colour, variable)
    svg = re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', "", svg, count=1)
    svg = re.sub(
        r' id="((?:figure|axes|patch|line2d|text|xtick|ytick|matplotlib)[^"]*)"',
        r' class="\1"',
        svg,
    )
    title = f'role="img" aria-label="{escape(name)}">'
    return svg.replace(">", f" {title}", 1)


def thinned(x: Array, y: Array, most: int = 1500) -> tuple[Array, Array]:
    """At most so many points of a curve, evenly taken."""
    step = max(1, -(-len(x) // most))
    return x[::step], y[::step]
