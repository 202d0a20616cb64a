"""A figure of estimates, for notebooks and papers."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from testbed.experiment.run import Run
from testbed.identification.estimate import NAMES, Estimate
from testbed.reporting.error_dots import ErrorDots, dots_of_run, error_dots, shown
from testbed.reporting.figures import APART, power_of_ten

COLOURS = {"external": "#0072b2", "internal": "#c75000", "faint": "#6a7380"}

FORMS = {"external": "o", "internal": "D"}

WIDTH, ROW, FRAME = 6.4, 0.19, 1.12
"""Of the figure; height of a row, and of legend and axis [inches]."""

TICKS = 7
"""Of the scale."""


class Picture(Figure):
    """A figure that a notebook shows, whether pyplot was ever imported or not."""

    def _repr_png_(self) -> bytes:
        content = io.BytesIO()
        self.savefig(content, format="png", dpi=120)
        return content.getvalue()


def plot(what: Run | Estimate) -> Picture:
    """How far off each parameter is, a dot a method; relative sigmas where no truth is known.

    Bars end at one standard deviation, as the estimate itself states it.

    Args:
        what: A run, or one estimate.

    Returns:
        A matplotlib figure of its own: a notebook shows it, `savefig` writes it.
    """
    dots = dots_of_run(what) if isinstance(what, Run) else error_dots({what.method: what})
    figure = Picture(figsize=(WIDTH, ROW * max(len(dots.names), 1) + FRAME), layout="tight")
    axis = figure.subplots()
    _draw(axis, dots)
    bar = Line2D([], [], color=COLOURS["faint"], linewidth=2.6, alpha=0.5)
    lines = [line for line in axis.get_lines() if line.get_marker() in FORMS.values()]
    labels = [NAMES[method] for method in dots.errors]
    if dots.sigmas:
        lines, labels = [*lines, bar], [*labels, "up to one sigma"]
    axis.legend(
        lines, labels, loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False, borderpad=0
    )
    return figure


def _draw(axis: Axes, dots: ErrorDots) -> None:
    """A row a parameter, with dots and bars."""
    rows = np.arange(len(dots.names), dtype=float)
    low, high = dots.range
    for k, (method, errors) in enumerate(dots.errors.items()):
        place = rows + APART * (k - (len(dots.errors) - 1) / 2)
        colour = COLOURS[method]
        if method in dots.sigmas:
            sigma = np.clip(dots.sigmas[method], low, high)
            axis.hlines(place, low, sigma, color=colour, linewidth=2.6, alpha=0.28)
        at = shown(errors, (low, high))
        axis.plot(at, place, FORMS[method], color=colour, markersize=3.6, clip_on=False)
    axis.set_xscale("log")
    axis.set_xlim(low, high)
    axis.set_ylim(len(rows) - 0.5, -0.5)
    axis.set_yticks(rows, dots.names)
    axis.tick_params(axis="y", length=0)
    axis.grid(True, axis="x", color=COLOURS["faint"], alpha=0.35)
    axis.xaxis.set_major_locator(LogLocator(numticks=TICKS))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: power_of_ten(value)))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xlabel(dots.label, labelpad=3)
