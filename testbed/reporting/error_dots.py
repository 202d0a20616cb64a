"""How far off, or how uncertain, each parameter is: a dot a method, on a logarithmic scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.experiment.run import Run
from testbed.experiment.score import Errors
from testbed.identification.estimate import METHODS, Estimate, Method
from testbed.identification.estimate_text import ROUNDING
from testbed.identification.influence import by_influence
from testbed.reporting.figures import (
    COLOURS,
    FAINT,
    STYLE,
    WIDER,
    WIDTH,
    as_svg,
    labels_room,
    power_of_ten,
)
from testbed.reporting.named_panels import COLUMNS, MOST_ROWS

MOST = 60
"""Parameters drawn; of more, those that add most to the predicted signals."""

LEAST = 1e-12
"""Share of the largest below which a dot stands at the edge, as an error of nothing does."""

ROW, FRAME = 0.19, 0.62
"""Height of a row, and of title and axis [inches]."""

TICKS = 10
"""Of a scale as wide as a panel."""

FORMS = {"external": "o", "internal": "D"}


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

    def part(self, chosen: NDArray[np.intp]) -> ErrorDots:
        """Some of the parameters."""
        return replace(
            self,
            names=tuple(self.names[k] for k in chosen),
            errors={method: values[chosen] for method, values in self.errors.items()},
            sigmas={method: values[chosen] for method, values in self.sigmas.items()},
        )

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
    told = (size > 0) & (estimate.sigma > ROUNDING * size) & np.isfinite(estimate.sigma)
    shares: Array = estimate.sigma / np.where(told, size, np.nan)
    return shares


def _placed(names: Sequence[str], estimate: Estimate, values: Array) -> Array:
    """An estimate's values by name, in percent; not a number where it has none, or no end."""
    place = dict(zip(estimate.names, 100 * values, strict=True))
    there = np.array([place.get(name, np.nan) for name in names])
    return np.where(np.isfinite(there), there, np.nan)


def draw(
    axis: Axes, dots: ErrorDots, limits: tuple[float, float], colours: Mapping[str, str]
) -> None:
    """Draw on an axis.

    Args:
        axis: Where.
        dots: What.
        limits: Of the scale [%].
        colours: By method, and "faint".
    """
    rows = np.arange(len(dots.names), dtype=float)
    low, high = limits
    for k, (method, errors) in enumerate(dots.errors.items()):
        place = rows + (0.16 * (2 * k - 1) if len(dots.errors) > 1 else 0.0)
        shown = np.where(np.isnan(errors), np.nan, np.clip(errors, low, high))
        colour = colours[method]
        if method in dots.sigmas:
            sigma = np.clip(dots.sigmas[method], low, high)
            axis.hlines(place, low, sigma, color=colour, linewidth=2.6, alpha=0.28)
        axis.plot(shown, place, FORMS[method], color=colour, markersize=3.6, clip_on=False)
    axis.set_xscale("log")
    axis.set_xlim(low, high)
    axis.set_ylim(len(rows) - 0.5, -0.5)
    axis.set_yticks(rows, dots.names)
    axis.tick_params(axis="y", length=0)
    axis.grid(True, axis="x", color=colours["faint"], alpha=0.35)
    axis.grid(False, axis="y")
    axis.xaxis.set_major_locator(
        LogLocator(numticks=max(3, int(TICKS * axis.get_position().width)))
    )
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: power_of_ten(value)))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xlabel("relative error [%]" if dots.sigmas else "relative sigma [%]", labelpad=3)


def dot_panels(dots: ErrorDots) -> list[dict[str, str]]:
    """The drawing as elements of a page, on one scale.

    Args:
        dots: What is drawn.
    """
    count = len(dots.names)
    parts = [
        dots.part(k) for k in np.array_split(np.arange(count), COLUMNS if count > MOST_ROWS else 1)
    ]
    left = max(labels_room(*_figure(part, dots.range, 0.2)) for part in parts)
    return [_panel(part, dots.range, min(0.6, WIDER * left)) for part in parts]


def _panel(dots: ErrorDots, limits: tuple[float, float], left: float) -> dict[str, str]:
    title = f"{dots.names[0]} to {dots.names[-1]}"
    with rc_context({"svg.hashsalt": title, "svg.fonttype": STYLE["svg.fonttype"]}):
        return {"title": title, "svg": as_svg(_figure(dots, limits, left)[0], title)}


def _figure(dots: ErrorDots, limits: tuple[float, float], left: float) -> tuple[Figure, Axes]:
    """A panel whose labels have so much room, part of its width."""
    height = ROW * len(dots.names) + FRAME
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        axis = figure.subplots()
        figure.subplots_adjust(left=left, right=0.94, bottom=0.5 / height, top=1 - 0.1 / height)
        draw(axis, dots, limits, {**COLOURS, "faint": FAINT})
    return figure, axis


def dots_section(run: Run) -> dict[str, Any] | None:
    """The figure for a page, with what it says and the same as a table; None without estimates.

    Args:
        run: What it is about.
    """
    dots = dots_of_run(run)
    if not dots.names:
        return None
    judged = bool(dots.sigmas)
    order = "What adds most to the predicted forces comes first"
    part = f"{order}; these are the first {MOST}." if len(dots.names) == MOST else f"{order}."
    heads = [f"{'error' if judged else 'sigma'}, {method} [%]" for method in dots.errors]
    return {
        "id": "errors",
        "title": "How far off each parameter is" if judged else "How well each parameter is known",
        "says": "Errors against the truth; the bars end at one standard deviation, as the estimate "
        "itself states it. A dot far beyond its bar is an error that sigma does not tell."
        if judged
        else "One standard deviation, as the estimate itself states it, as part of the value.",
        "legend": {method: LEGEND[method] for method in dots.errors},
        "panels": dot_panels(dots),
        "caption": f"Logarithmic; further to the left is better. {part}",
        "heads": ["parameter", *heads],
        "rows": [
            [name, *(_number(values[k]) for values in dots.errors.values())]
            for k, name in enumerate(dots.names)
        ],
    }


LEGEND: dict[Method, str] = {
    "external": "bedplate (external)",
    "internal": "joint torques (internal)",
}


def _number(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.2g}"
