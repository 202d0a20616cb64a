"""A figure of estimates, for notebooks and papers."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from testbed.core.base.arrays import Array
from testbed.core.base.summary_table import ROUNDING
from testbed.core.estimation.estimate import METHODS, Estimate, Method, by_influence
from testbed.core.estimation.information import Information
from testbed.core.recordings.recording import Recording
from testbed.lab.experiment.predict import Predictions, predict
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.score import Errors
from testbed.view.figures import APART, Panel, named_panels, power_of_ten
from testbed.view.section import Section, Table

MOST = 60
"""Parameters drawn; of more, those that add most to the predicted signals."""

LEAST = 1e-12
"""Share of the largest below which a dot stands at the edge, as an error of nothing does."""


@dataclass(frozen=True, eq=False)
class ErrorDots:
    """What is drawn.

    Attributes:
        names: Of the parameters, (p,).
        errors: By method: relative error, or where the truth is not known relative sigma, (p,)
            [%]; not a number where a method has none.
        sigmas: By method: relative sigma, (p,) [%]; {} where it is what `errors` says.
    """

    names: tuple[str, ...]
    errors: Mapping[Method, Array]
    sigmas: Mapping[Method, Array]

    @property
    def label(self) -> str:
        """Of the scale."""
        return "relative error [%]" if self.sigmas else "relative standard deviation [%]"

    @property
    def range(self) -> tuple[float, float]:
        """Powers of ten between which everything lies [%]."""
        every = np.concatenate([*self.errors.values(), *self.sigmas.values()])
        there = every[np.isfinite(every) & (every > 0)]
        if not there.size:
            return 0.1, 1.0
        low, high = max(there.min(), LEAST * there.max()), there.max()
        low = 10.0 ** np.floor(np.log10(low))
        return float(low), float(max(10.0 ** np.ceil(np.log10(high)), 10 * low))


def error_dots(
    found: Mapping[Method, Estimate], judged: Mapping[Method, Errors] | None = None
) -> ErrorDots:
    """What there is to draw of estimates, first the parameter that adds most to the signals.

    Args:
        found: By method, of one robot.
        judged: Their errors, where the truth is known.
    """
    estimates = [found[m] for m in reversed(METHODS) if m in found]
    truths = {} if judged is None else _truths(judged)
    names = tuple(by_influence(estimates, truths)[:MOST])
    errors: dict[Method, Array] = {}
    sigmas: dict[Method, Array] = {}
    for method in METHODS:
        if method not in found:
            continue
        estimate = found[method]
        if judged is None:
            errors[method] = _placed(names, estimate, _own_sigmas(estimate))
            continue
        errors[method] = _placed(names, estimate, np.abs(judged[method].relative))
        sigmas[method] = _placed(names, estimate, estimate.sigma / judged[method].scale)
    return ErrorDots(names, errors, sigmas)


def _truths(judged: Mapping[Method, Errors]) -> dict[str, float]:
    every = (zip(e.names, e.truth.tolist(), strict=True) for e in judged.values())
    return {name: value for pairs in every for name, value in pairs}


def dots_of_run(run: Run) -> ErrorDots:
    """What there is to draw of a run."""
    return error_dots(run.estimates, None if run.score is None else run.score.errors)


def _own_sigmas(estimate: Estimate) -> Array:
    """Relative sigmas; not a number where a value is zero, known, or not identifiable."""
    size = np.abs(estimate.values)
    known = (size > 0) & (estimate.sigma > ROUNDING * size) & np.isfinite(estimate.sigma)
    shares: Array = estimate.sigma / np.where(known, size, np.nan)
    return shares


def _placed(names: Sequence[str], estimate: Estimate, values: Array) -> Array:
    """An estimate's values by name, in percent; not a number where it has none, or no end."""
    place = dict(zip(estimate.names, 100 * values, strict=True))
    there = np.array([place.get(name, np.nan) for name in names])
    return np.where(np.isfinite(there), there, np.nan)


def shown(errors: Array, limits: tuple[float, float]) -> Array:
    """Errors where dots stand: at the edge, if beyond it; nan where there is none.

    Args:
        errors: (p,) [%].
        limits: Of the scale [%].
    """
    return np.where(np.isnan(errors), np.nan, np.clip(errors, *limits))


def dot_panels(dots: ErrorDots) -> list[Panel]:
    """The drawing, in several plots on one scale where there are many parameters.

    Args:
        dots: What is drawn.
    """
    limits = dots.range
    bars: dict[str, tuple[Array, Array]] = {
        method: (np.full(len(sigma), limits[0]), np.clip(sigma, *limits))
        for method, sigma in dots.sigmas.items()
    }
    values: dict[str, Array] = {m: shown(errors, limits) for m, errors in dots.errors.items()}
    return named_panels("", dots.names, values, dots.label, bars=bars, pale=True, log=True)


def dots_section(run: Run) -> Section | None:
    """The figure for a page, with what it says and the same as a table; None without estimates.

    Args:
        run: What it is about.
    """
    dots = dots_of_run(run)
    if not dots.names:
        return None
    judged = bool(dots.sigmas)
    order = "Sorted by influence on the predicted forces"
    part = f"{order}; these are the first {MOST}." if len(dots.names) == MOST else f"{order}."
    what = "error" if judged else "std"
    heads = [f"{what}, {run.instruments[method]} [%]" for method in dots.errors]
    return Section(
        id="errors",
        title="Parameter errors" if judged else "Standard deviations of the parameters",
        says=(
            "Errors against the truth (dots) and estimated standard deviations (bars). A dot "
            "far outside its bar is a bias."
            if judged
            else "Estimated standard deviation divided by the value."
        ),
        legend={method: run.instruments[method] for method in dots.errors},
        panels=dot_panels(dots),
        caption=f"Logarithmic scale. {part}",
        table=Table(
            ["parameter", *heads],
            [
                [name, *(_number(values[k]) for values in dots.errors.values())]
                for k, name in enumerate(dots.names)
            ],
        ),
    )


def _number(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.2g}"


COLOURS = {"external": "#0072b2", "internal": "#c75000", "faint": "#6a7380"}

FORMS = {"external": "o", "internal": "D"}

PANEL = 0.9
"""Height of a channel's axis [inches]."""

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


def plot(what: Recording | Run | Estimate, *estimates: Estimate | Information) -> Picture:
    """Draw residuals of a recording over time, or errors of parameters.

    Args:
        what: A recording: what estimates leave of each channel. A run or an estimate: errors of
            the parameters, bars to one standard deviation; relative standard deviations where no
            truth is known.
        estimates: Of the recording's robot.

    Returns:
        A matplotlib figure of its own: a notebook shows it, `savefig` writes it.
    """
    if isinstance(what, Recording):
        return _residuals(predict(what, *estimates))
    dots = dots_of_run(what) if isinstance(what, Run) else error_dots({what.method: what})
    figure = Picture(figsize=(WIDTH, ROW * max(len(dots.names), 1) + FRAME), layout="tight")
    axis = figure.subplots()
    _draw(axis, dots)
    bar = Line2D([], [], color=COLOURS["faint"], linewidth=2.6, alpha=0.5)
    lines = [line for line in axis.get_lines() if line.get_marker() in FORMS.values()]
    named = what.instruments if isinstance(what, Run) else {what.method: what.instrument}
    labels = [named[method] for method in dots.errors]
    if dots.sigmas:
        lines, labels = [*lines, bar], [*labels, "up to one sigma"]
    axis.legend(
        lines, labels, loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False, borderpad=0
    )
    return figure


def _residuals(found: Predictions) -> Picture:
    """Measured less predicted over time, an axis a channel, a line an estimate.

    Args:
        found: What estimates predict of a recording.
    """
    count = sum(len(signal.channels) for signal in found.signals)
    figure = Picture(figsize=(WIDTH, PANEL * count + FRAME), layout="tight")
    axes = iter(figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
    for signal in found.signals:
        for k, channel in enumerate(signal.channels):
            axis = next(axes)
            axis.set_ylabel(f"{channel} [{signal.units[k]}]")
            for method in signal.predicted:
                residual = signal.residual(method)[:, k]
                axis.plot(found.time, residual, color=COLOURS[method], lw=0.6)
    axis.set_xlabel("time [s]")
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
