"""A figure of estimates, for notebooks and papers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.summary_table import ROUNDING
from testbed.core.estimation.estimate import METHODS, Estimate, Method
from testbed.core.estimation.influence import by_influence
from testbed.core.estimation.information import Information
from testbed.core.recordings.recording import Recording
from testbed.lab.experiment.predict import Predictions, predict
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.score import Errors
from testbed.view.drawing import Picture, draw
from testbed.view.figures import Panel, decades, named_panel, named_panels
from testbed.view.section import Section, Table

WIDTH = 6.4
"""Of a figure for a paper [inches]."""

MOST = 60
"""Parameters drawn; of more, those that add most to the predicted signals."""

LEAST = 1e-12
"""Share of the largest value at which smaller ones are drawn."""


@dataclass(frozen=True, eq=False)
class ErrorDots:
    """Relative errors and standard deviations of estimates.

    Attributes:
        names: Of the parameters, (p,).
        errors: Absolute relative errors by method, or where the truth is not known relative
            standard deviations, (p,) [%]; not a number where a method has none.
        sigmas: Relative standard deviations by method, (p,) [%]; {} without a truth.
    """

    names: Sequence[str]
    errors: Mapping[Method, Array]
    sigmas: Mapping[Method, Array]

    @property
    def label(self) -> str:
        """Quantity on the horizontal axis."""
        return (
            "relative error [%]" if self.sigmas else "relative standard deviation [%]"
        )

    @property
    def drawn(self) -> tuple[dict[str, Array], dict[str, tuple[Array, Array]]]:
        """Positions of the dots, and ends of the bars from the axis to one sigma."""
        every = np.concatenate([*self.errors.values(), *self.sigmas.values(), [0.0]])
        least = LEAST * np.nanmax(every)
        dots: dict[str, Array] = {
            m: np.maximum(each, least) for m, each in self.errors.items()
        }
        low = decades(np.maximum(every[every > 0], least))[0]
        bars: dict[str, tuple[Array, Array]] = {
            method: (np.full(len(sigma), low), np.maximum(sigma, low))
            for method, sigma in self.sigmas.items()
        }
        return dots, bars


def error_dots(
    estimates: Mapping[Method, Estimate], judged: Mapping[Method, Errors] | None = None
) -> ErrorDots:
    """Relative errors, first of the parameter that adds most to the signals.

    Args:
        estimates: By method, of one robot.
        judged: Their errors, where the truth is known.
    """
    truths: dict[str, float] = {}
    for each in (judged or {}).values():
        truths |= zip(each.names, each.truth.tolist(), strict=True)
    backwards = [
        estimates[method] for method in reversed(METHODS) if method in estimates
    ]
    names = by_influence(backwards, truths)[:MOST]
    errors: dict[Method, Array] = {}
    sigmas: dict[Method, Array] = {}
    for method, estimate in estimates.items():
        if judged is None:
            errors[method] = _by_name(names, estimate, _relative_sigmas(estimate))
        else:
            errors[method] = _by_name(names, estimate, np.abs(judged[method].relative))
            sigmas[method] = _by_name(
                names, estimate, estimate.sigma / judged[method].scale
            )
    return ErrorDots(names, errors, sigmas)


def dots_of_run(run: Run) -> ErrorDots:
    """Relative errors of a run's estimates."""
    return error_dots(run.estimates, None if run.score is None else run.score.errors)


def _relative_sigmas(estimate: Estimate) -> Array:
    """Relative sigmas; not a number where a value is zero, known, or not identifiable."""
    size = np.abs(estimate.values)
    known = (size > 0) & (estimate.sigma > ROUNDING * size)
    return estimate.sigma / np.where(known, size, np.nan)


def _by_name(names: Sequence[str], estimate: Estimate, values: Array) -> Array:
    """Finite values by name in percent; not a number where an estimate has none."""
    places = dict(zip(estimate.names, values.tolist(), strict=True))
    found = 100 * np.array([places.get(name, np.nan) for name in names])
    return np.where(np.isfinite(found), found, np.nan)


def dots_section(run: Run) -> Section | None:
    """Errors of a run's parameters, drawn and as a table; None without estimates.

    Args:
        run: The run.
    """
    dots = dots_of_run(run)
    if not dots.names:
        return None
    judged = bool(dots.sigmas)
    order = "Sorted by influence on the predicted forces"
    part = (
        f"{order}; these are the first {MOST}."
        if len(dots.names) == MOST
        else f"{order}."
    )
    what = "error" if judged else "std"
    rows = np.column_stack([*dots.errors.values()])
    values, bars = dots.drawn
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
        panels=named_panels("", dots.names, values, dots.label, bars=bars, log=True),
        caption=f"Logarithmic scale. {part}",
        table=Table(
            [
                "parameter",
                *(f"{what}, {run.instruments[method]} [%]" for method in dots.errors),
            ],
            [
                [name, *("" if np.isnan(value) else f"{value:.2g}" for value in row)]
                for name, row in zip(dots.names, rows.tolist(), strict=True)
            ],
        ),
    )


def plot(
    what: Recording | Run | Estimate, *estimates: Estimate | Information
) -> Picture:
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
    dots = (
        dots_of_run(what) if isinstance(what, Run) else error_dots({what.method: what})
    )
    instruments = (
        what.instruments if isinstance(what, Run) else {what.method: what.instrument}
    )
    values, bars = dots.drawn
    label = f"{dots.label}; bars: one standard deviation" if bars else dots.label
    figure = draw(
        named_panel("", dots.names, values, label, bars=bars, log=True), WIDTH
    )
    axis = figure.axes[0]
    lines, methods = axis.get_legend_handles_labels()
    labels = [instruments[method] for method in methods]
    axis.legend(
        lines[::-1],
        labels[::-1],
        loc="lower left",
        bbox_to_anchor=(0, 1),
        ncols=2,
        frameon=False,
        fontsize=9,
    )
    return figure


def _residuals(found: Predictions) -> Picture:
    """Measured less predicted over time, a plot a channel, a line an estimate."""
    plots = {
        f"{channel.name} [{channel.unit}]": {
            method: (found.time, left) for method, left in channel.residuals.items()
        }
        for channel in found.channels
    }
    (title, curves), *below = plots.items()
    return draw(Panel(title, curves, "time [s]", below=dict(below)), WIDTH)
