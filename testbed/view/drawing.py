"""Panels drawn as matplotlib figures and as SVG elements of HTML pages."""

from __future__ import annotations

import re
from html import escape
from importlib.resources import files
from io import BytesIO, StringIO
from typing import Any

import numpy as np
from matplotlib import rc_context, rc_params_from_file
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from testbed.view.figures import Curves, Panel, enclosing_decades

COLOURS = {
    "measured": "#a3abb6",
    "wrench": "#0072b2",
    "torque": "#c75000",
    "ink": "#1b2027",
    "faint": "#6a7380",
}
"""Colours by kind, the names of CSS variables; later curves lie on top."""

MARKERS = {"measured": ".", "wrench": "o", "torque": "D"}
"""Point markers by kind of curve."""

STYLE: dict[Any, Any] = rc_params_from_file(
    str(files("testbed.view") / "page" / "figures.mplstyle"), use_default_template=False
)
"""Settings that differ from matplotlib's default style."""

MIN_AXES_WIDTH, LETTER_WIDTH = 1.6, 0.09
"""Smallest width of axes beside row names, and width of a letter of these names [inches]."""

TRANSPARENT = dict.fromkeys(("axes.facecolor", "figure.facecolor"), "none")
"""Settings of transparent backgrounds."""

FIGURE_WIDTH, AXES_HEIGHT, LOWER_AXES_HEIGHT, ROW_HEIGHT, LABELS_HEIGHT = (
    4.1,
    1.2,
    0.85,
    0.19,
    0.65,
)
"""Width of a figure; heights of its axes, axes below, named rows and labels [inches]."""

MIN_LINE_WIDTH, LINE_WIDTH_STEP = 1.0, 1.2
"""Width of the top line, and increment for each line below it [points]."""

MAX_LARGE_MARKERS = 200
"""Largest number of points with large markers."""


UNUSED_SVG_PARTS = re.compile(
    r'(?s)\A.*?(?=<svg)|(?<=<svg)[^>]*(?= viewBox)|<style.*?</style>| id="[\w.]+_\d+"'
)
"""Parts of matplotlib's SVG not used in a page: header, size, style, names of groups."""


class Picture(Figure):
    """Matplotlib figure that a notebook displays without pyplot."""

    def _repr_png_(self) -> bytes:
        """PNG image of the figure, displayed by notebooks."""
        content = BytesIO()
        self.savefig(content, format="png", dpi=120)
        return content.getvalue()


def draw(panel: Panel, width: float = FIGURE_WIDTH) -> Picture:
    """Draw a panel: main plot above the lower plots, with a common horizontal axis.

    Args:
        panel: Panel to draw.
        width: Minimum width of the figure [inches]; long row names widen it.
    """
    plots = {panel.title: panel.curves, **panel.lower_plots}
    heights = [
        ROW_HEIGHT * len(panel.names) or AXES_HEIGHT,
        *[LOWER_AXES_HEIGHT] * len(panel.lower_plots),
    ]
    width = max(
        width, MIN_AXES_WIDTH + LETTER_WIDTH * max(map(len, panel.names), default=0)
    )
    with rc_context(STYLE):
        figure = Picture(
            figsize=(width, sum(heights) + LABELS_HEIGHT), layout="constrained"
        )
        axes = figure.subplots(
            len(plots), sharex=True, squeeze=False, height_ratios=heights
        )
        for axis, (title, curves) in zip(axes.ravel(), plots.items(), strict=True):
            axis.set_title(title)
            _draw_curves(axis, panel, curves)
            _set_scales(axis, panel, curves)
        axis.set_xlabel(panel.x_label)
    return figure


def _draw_curves(axis: Axes, panel: Panel, curves: Curves) -> None:
    """Draw curves with bands and error bars.

    Kinds of curves that come first in `COLOURS` are drawn with wider lines, below the others.

    Args:
        axis: Axes of the plot.
        panel: Panel with bands, bars, and kinds drawn as points.
        curves: Curves of the plot, by kind.
    """
    kinds = [kind for kind in COLOURS if kind in curves]
    for rank, kind in enumerate(reversed(kinds)):
        (x, y), colour = curves[kind], COLOURS[kind]
        if kind in panel.bands:
            low, high = y - panel.bands[kind], y + panel.bands[kind]
            axis.fill_between(
                x, low, high, color=colour, alpha=0.3, linewidth=0, zorder=1
            )
        if kind in panel.bars:
            axis.hlines(y, *panel.bars[kind], color=colour, alpha=0.28, linewidth=2.6)
        (line,) = axis.plot(
            x,
            y,
            color=colour,
            linewidth=MIN_LINE_WIDTH + LINE_WIDTH_STEP * rank,
            label=kind,
        )
        if kind in panel.points:
            line.set(linestyle="", marker=MARKERS[kind], clip_on=False)
            line.set_markersize(1.5 if len(x) > MAX_LARGE_MARKERS else 4.0)
        line.set_zorder(4 - rank)


def _set_scales(axis: Axes, panel: Panel, curves: Curves) -> None:
    """Set scales, limits, ticks and reference line of a plot.

    A logarithmic axis requires a positive value. Row names replace the numbers on the vertical
    axis, with the first name at the top.

    Args:
        axis: Axes of the plot.
        panel: Panel with the settings.
        curves: Curves of the plot: those of the panel or of a lower plot.
    """
    axis.margins(x=0.02)
    axis.locator_params(axis="x", nbins=5)
    axis.locator_params(axis="y", nbins=5 if curves is panel.curves else 3)
    values = np.concatenate([y for _, y in curves.values()])
    if panel.log_scale and (panel.names or (values > 0).any()):
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(numticks=5))
        if not panel.names:
            axis.set_yscale("log")
            axis.set_ylim(enclosing_decades(values))
        axis.minorticks_off()
    axis.xaxis.set_major_formatter("{x:g}")
    axis.yaxis.set_major_formatter("{x:g}")
    if panel.limits is not None:
        axis.set_xlim(panel.limits)
    if panel.names:
        axis.set_yticks(range(len(panel.names)), panel.names)
        axis.set_ylim(len(panel.names) - 0.5, -0.5)
        axis.tick_params(axis="y", length=0)
        axis.grid(visible=False, axis="y")
    if panel.reference_value is not None:
        axis.axvline(
            panel.reference_value,
            color=COLOURS["measured"],
            linewidth=MIN_LINE_WIDTH,
            zorder=1,
        )
    if panel.from_zero:
        axis.set_ylim(bottom=0.0)


def svg(panel: Panel) -> str:
    """SVG element of a panel for HTML pages; colours are CSS variables named by kind.

    Args:
        panel: Panel to draw.
    """
    file = StringIO()
    metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with rc_context(
        STYLE | TRANSPARENT | {"svg.hashsalt": panel.title + panel.x_label}
    ):
        # canvas instead of savefig, which draws each figure twice
        FigureCanvasSVG(draw(panel)).print_svg(file, metadata=metadata)  # type: ignore[no-untyped-call]
    text = UNUSED_SVG_PARTS.sub("", file.getvalue()).replace("xlink:href", "href")
    for kind, colour in COLOURS.items():
        text = text.replace(colour, f"var(--{kind})")
    return text.replace(
        "<svg", f'<svg role="img" aria-label="{escape(panel.text_alternative)}"', 1
    )
