"""Figures as SVG that takes its colours from the page: text stays text, nothing is fetched."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from testbed.arrays import Array

INK, FAINT = "#010203", "#010204"
"""Stand for the page's text colour and a fainter one."""
COLOURS = {
    "measured": "#010205",
    "unexplained": "#010205",
    "external": "#010206",
    "internal": "#010207",
}
"""By what curves are; later ones are drawn over earlier ones."""
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
LEFT, RIGHT, BOTTOM, TOP = 0.47, 0.18, 0.45, 0.2
"""Around its axes [inches]."""
LOWER = 0.68
"""Height of axes that stand below others [inches]."""
ROW = 0.19
"""Height of a named row [inches]."""
WIDER = 1.05
"""Room for labels in a font wider than the one they are measured in."""
THIN, THICKER = 1.0, 1.2
"""Width of the line on top, and by how much each one below is wider: it is seen on both sides."""
DOT, SMALL = 7.0, 2.0
"""Size of points."""
FEW = 200
"""Points of a curve, more than which are small."""

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

Curves = Mapping[str, tuple[Array, Array]]  # x and y by what they are: measured, external, ...


@dataclass(frozen=True, eq=False)
class Panel:
    """One small plot, or several below each other over one horizontal axis.

    Attributes:
        title: What it shows, with unit.
        curves: By what they are: "measured", "external", "internal" or "unexplained".
        x_label: With unit.
        log: Both axes logarithmic; of named rows the horizontal one.
        points: Which curves are drawn as points.
        bars: Ends of the bars of points, by curve.
        bands: Half the width of the band around a line, by curve.
        names: Of the rows 0, 1, ... from above, where points stand in such.
        limits: Of the horizontal axis; None for what the curves need.
        from_zero: The vertical axis begins at zero.
        below: Curves of further plots, by their titles.
    """

    title: str
    curves: Curves
    x_label: str
    log: bool = False
    points: tuple[str, ...] = ()
    bars: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    bands: Mapping[str, Array] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    limits: tuple[float, float] | None = None
    from_zero: bool = False
    below: Mapping[str, Curves] = field(default_factory=dict)

    @property
    def svg(self) -> str:
        """The plot as an element of a page."""
        with rc_context(STYLE | {"svg.hashsalt": self.says}):
            return as_svg(self.drawn(), self.says)

    @property
    def says(self) -> str:
        """What it shows, for those who do not see it."""
        rows = [f"{self.names[0]} to {self.names[-1]}"] if self.names else []
        return f"{', '.join([self.title, *rows, *self.below])} over {self.x_label}"

    def drawn(self) -> Figure:
        """The plot as matplotlib's."""
        heights = [HEIGHT - BOTTOM - TOP, *(LOWER for _ in self.below)]
        if self.names:
            heights[0] = ROW * len(self.names)
        total = sum(heights) + TOP * len(heights) + BOTTOM
        with rc_context(STYLE):
            figure = Figure(figsize=(WIDTH, total))
            every = {self.title: self.curves, **self.below}
            high = total
            axes: list[Axes] = []
            for height, (title, curves) in zip(heights, every.items(), strict=True):
                high -= height + TOP
                place = (LEFT / WIDTH, high / total, 1 - (LEFT + RIGHT) / WIDTH, height / total)
                axes.append(figure.add_axes(place, sharex=axes[0] if axes else None))
                self._draw(axes[-1], title, curves)
                axes[-1].tick_params(labelbottom=len(axes) == len(heights))
            axes[-1].set_xlabel(self.x_label, labelpad=3)
            room = WIDER * max(labels_room(figure, axis) for axis in axes)
            left = min(max(LEFT / WIDTH, room), 0.6)
            for axis in axes:
                box = axis.get_position()
                axis.set_position((left, box.y0, 1 - RIGHT / WIDTH - left, box.height))
        return figure

    def _draw(self, axis: Axes, title: str, curves: Curves) -> None:
        drawn = [label for label in COLOURS if label in curves]
        lines = [label for label in drawn if label not in self.points]
        for label in drawn:
            x, y = curves[label]
            style: dict[str, Any] = {"color": COLOURS[label]}
            if label in lines:
                style["linewidth"] = THIN + THICKER * (len(lines) - 1 - lines.index(label))
            else:
                size = SMALL if len(x) > FEW else DOT
                style |= {"linestyle": "none", "marker": ".", "markersize": size}
            axis.plot(x, y, **style)
            if label in self.bars:
                ends = self.bars[label]
                (axis.hlines if self.names else axis.vlines)(
                    y if self.names else x, *ends, color=COLOURS[label], linewidth=THIN
                )
            if label in self.bands:
                wide, colour = np.asarray(self.bands[label]), COLOURS[label]
                axis.fill_between(x, y - wide, y + wide, color=colour, alpha=0.3, linewidth=0)
        axis.set_title(title, loc="left")
        positive = any((np.asarray(line.get_ydata()) > 0).any() for line in axis.lines)
        if self.names:
            _in_rows(axis, self.names, self.log)
        else:
            (_logarithmic if self.log and positive else _linear)(axis)
            if self.below:
                _two_or_three(axis)
        if self.from_zero:
            axis.set_ylim(bottom=0.0)
        if self.limits is not None:
            axis.set_xlim(self.limits)


def labels_room(figure: Figure, axis: Axes) -> float:
    """What the labels of the vertical axis need, part of the figure's width."""
    canvas: Any = FigureCanvasAgg(figure)
    box = axis.yaxis.get_tightbbox(canvas.get_renderer())
    return 0.0 if box is None else float((axis.bbox.x0 - box.x0) / figure.bbox.width)


def _in_rows(axis: Axes, names: Sequence[str], log: bool) -> None:
    """A row a name, from above."""
    if log:
        axis.set_xscale("log")
        _powers(axis.xaxis, 6)
    else:
        _round(axis.xaxis, 6)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_yticks(range(len(names)), names)
    axis.tick_params(axis="y", length=0)
    axis.grid(False, axis="y")


def _linear(axis: Axes) -> None:
    """Few round ticks."""
    _round(axis.xaxis, 6)
    _round(axis.yaxis, 4)


def _two_or_three(axis: Axes) -> None:
    """Ticks of a low plot: every second of those that do not leave room for their labels."""
    _round(axis.yaxis, 2)
    low, high = axis.get_ylim()
    ticks = [tick for tick in axis.get_yticks() if low <= tick <= high]
    if len(ticks) > 3:
        axis.set_yticks(ticks[::2])


def _round(scale: Axis, most: int) -> None:
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
    _powers(axis.xaxis, 6)
    _powers(axis.yaxis, 4)


def _powers(scale: Axis, most: int) -> None:
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
