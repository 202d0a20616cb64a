"""A figure of estimates, for notebooks and papers."""

from __future__ import annotations

import io

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from testbed.experiment.run import Run
from testbed.identification.estimate import Estimate
from testbed.reporting.error_dots import FORMS, FRAME, LEGEND, ROW, dots_of_run, draw, error_dots

COLOURS = {"external": "#0072b2", "internal": "#c75000", "faint": "#6a7380"}

WIDTH = 6.4
"""Of the figure [inches]."""


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
    figure = Picture(figsize=(WIDTH, ROW * max(len(dots.names), 1) + FRAME + 0.5), layout="tight")
    axis = figure.subplots()
    draw(axis, dots, dots.range, COLOURS)
    bar = Line2D([], [], color=COLOURS["faint"], linewidth=2.6, alpha=0.5)
    lines = [line for line in axis.get_lines() if line.get_marker() in FORMS.values()]
    labels = [LEGEND[method] for method in dots.errors]
    if dots.sigmas:
        lines, labels = [*lines, bar], [*labels, "up to one sigma"]
    axis.legend(
        lines, labels, loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False, borderpad=0
    )
    return figure
