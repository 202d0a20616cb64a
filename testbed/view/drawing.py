"""Panels as matplotlib's figures, and as SVG that takes its colours from the page."""

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

from testbed.view.figures import Curves, Panel, decades

COLOURS = {
    "measured": "#a3abb6",
    "external": "#0072b2",
    "internal": "#c75000",
    "ink": "#1b2027",
    "faint": "#6a7380",
}
"""Colours by the names that the style sheet of a page gives them; later curves lie on top."""

MARKERS = {"measured": ".", "external": "o", "internal": "D"}

STYLE: dict[Any, Any] = rc_params_from_file(
    str(files("testbed.view") / "page" / "figures.mplstyle"), use_default_template=False
)
"""What differs from matplotlib's own style."""

AXIS, LETTER = 1.6, 0.09
"""Least width of the axis beside names, and width of a letter of theirs [inches]."""

TRANSPARENT = dict.fromkeys(("axes.facecolor", "figure.facecolor"), "none")

WIDTH, HEIGHT, LOWER, ROW, FRAME = 4.1, 1.2, 0.85, 0.19, 0.65
"""Of a figure, its axes, axes below, a named row; what labels take of the height [inches]."""

THIN, THICKER = 1.0, 1.2
"""Width of the line on top, and by how much each one below it is wider [points]."""

MANY = 200
"""Points above which they are drawn small."""


REMOVED = re.compile(
    r'(?s)\A.*?(?=<svg)|(?<=<svg)[^>]*(?= viewBox)|<style.*?</style>| id="[\w.]+_\d+"'
)
"""What an element of a page has no need of: header, size, style, names of groups."""


class Picture(Figure):
    """A figure that a notebook shows, whether pyplot was ever imported or not."""

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        self.savefig(content, format="png", dpi=120)
        return content.getvalue()


def draw(panel: Panel, width: float = WIDTH) -> Picture:
    """Draw a panel: its plot, and those below over the same horizontal axis.

    Args:
        panel: What is drawn.
        width: Of the figure, more where names are long [inches].
    """
    plots = {panel.title: panel.curves, **panel.below}
    heights = [ROW * len(panel.names) or HEIGHT, *[LOWER] * len(panel.below)]
    width = max(width, AXIS + LETTER * max(map(len, panel.names), default=0))
    with rc_context(STYLE):
        figure = Picture(figsize=(width, sum(heights) + FRAME), layout="constrained")
        axes = figure.subplots(
            len(plots), sharex=True, squeeze=False, height_ratios=heights
        )
        for axis, (title, curves) in zip(axes.ravel(), plots.items(), strict=True):
            axis.set_title(title)
            _draw_curves(axis, panel, curves)
            _scale(axis, panel, curves)
        axis.set_xlabel(panel.x_label)
    return figure


def _draw_curves(axis: Axes, panel: Panel, curves: Curves) -> None:
    """Curves with their bands and bars, each wider than those above it."""
    shown = [kind for kind in COLOURS if kind in curves]
    for over, kind in enumerate(reversed(shown)):
        (x, y), colour = curves[kind], COLOURS[kind]
        if kind in panel.bands:
            low, high = y - panel.bands[kind], y + panel.bands[kind]
            axis.fill_between(
                x, low, high, color=colour, alpha=0.3, linewidth=0, zorder=1
            )
        if kind in panel.bars:
            axis.hlines(y, *panel.bars[kind], color=colour, alpha=0.28, linewidth=2.6)
        (line,) = axis.plot(
            x, y, color=colour, linewidth=THIN + THICKER * over, label=kind
        )
        if kind in panel.points:
            line.set(linestyle="", marker=MARKERS[kind], clip_on=False)
            line.set_markersize(1.5 if len(x) > MANY else 4.0)
        line.set_zorder(4 - over)


def _scale(axis: Axes, panel: Panel, curves: Curves) -> None:
    """Set the scales of both axes, their limits and the labels of their ticks."""
    axis.margins(x=0.02)
    axis.locator_params(axis="x", nbins=5)
    axis.locator_params(axis="y", nbins=5 if curves is panel.curves else 3)
    values = np.concatenate([y for _, y in curves.values()])
    if panel.log and (panel.names or (values > 0).any()):
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(numticks=5))
        if not panel.names:
            axis.set_yscale("log")
            axis.set_ylim(decades(values))
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
    if panel.line is not None:
        axis.axvline(panel.line, color=COLOURS["measured"], linewidth=THIN, zorder=1)
    if panel.from_zero:
        axis.set_ylim(bottom=0.0)


def svg(panel: Panel) -> str:
    """A panel as an element of a page.

    Args:
        panel: What is drawn.
    """
    file = StringIO()
    metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with rc_context(
        STYLE | TRANSPARENT | {"svg.hashsalt": panel.title + panel.x_label}
    ):
        # the canvas itself: savefig draws each figure once more, to no file
        FigureCanvasSVG(draw(panel)).print_svg(file, metadata=metadata)  # type: ignore[no-untyped-call]
    text = REMOVED.sub("", file.getvalue()).replace("xlink:href", "href")
    for kind, colour in COLOURS.items():
        text = text.replace(colour, f"var(--{kind})")
    return text.replace(
        "<svg", f'<svg role="img" aria-label="{escape(panel.label)}"', 1
    )
