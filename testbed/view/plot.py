"""Figures of parameter errors and of residuals, for notebooks and papers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.summary_table import RELATIVE_ROUNDING
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.influence import names_by_influence
from testbed.core.estimation.information import Information
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.recording import Recording
from testbed.lab.experiment.predict import Predictions, predict
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.score import Errors
from testbed.view.drawing import Picture, draw
from testbed.view.figures import Panel, enclosing_decades, named_panel, named_panels
from testbed.view.section import Section, Table

FIGURE_WIDTH = 6.4
"""Width of a figure for a paper [inches]."""

MAX_PARAMETERS = 60
"""Largest number of drawn parameters; those with most influence on the predicted signals."""

MIN_DRAWN_SHARE = 1e-12
"""Smallest drawn value as a share of the largest value; smaller values are drawn there."""


@dataclass(frozen=True, eq=False)
class ErrorDots:
    """Relative errors and standard deviations of estimates, drawn as dots and bars.

    Attributes:
        names: Names of the parameters, (p,).
        errors: Absolute relative errors keyed by method, or relative standard deviations if the
            truth is unknown, (p,) each [%]; nan for parameters that a method does not estimate.
        sigmas: Relative standard deviations keyed by method, (p,) each [%]; {} if the truth is
            unknown.
    """

    names: Sequence[str]
    errors: Mapping[Signal, Array]
    sigmas: Mapping[Signal, Array]

    @property
    def label(self) -> str:
        """Quantity on the horizontal axis, with its unit."""
        return (
            "relative error [%]" if self.sigmas else "relative standard deviation [%]"
        )

    @property
    def dots_and_bars(self) -> tuple[dict[str, Array], dict[str, tuple[Array, Array]]]:
        """Positions of the dots, and (left, right) ends of the bars, by method, (p,) each [%].

        Bars extend from the lower end of the logarithmic axis to one standard deviation. Errors
        below the fraction `MIN_DRAWN_SHARE` of the largest value are drawn at this fraction.
        """
        values = np.concatenate([*self.errors.values(), *self.sigmas.values(), [0.0]])
        smallest = MIN_DRAWN_SHARE * np.nanmax(values)
        dots: dict[str, Array] = {
            method: np.maximum(error, smallest) for method, error in self.errors.items()
        }
        low = enclosing_decades(np.maximum(values[values > 0], smallest))[0]
        bars: dict[str, tuple[Array, Array]] = {
            method: (np.full(len(sigma), low), np.maximum(sigma, low))
            for method, sigma in self.sigmas.items()
        }
        return dots, bars


def error_dots(
    estimates: Mapping[Signal, Estimate],
    true_errors: Mapping[Signal, Errors] | None = None,
) -> ErrorDots:
    """Relative errors and sigmas of the parameters with most influence on the signals.

    At most `MAX_PARAMETERS` are included, in the order of decreasing influence. Errors and sigmas
    are relative to the scales of `Errors`; if the truth is unknown, sigmas are relative to the
    estimated values.

    Args:
        estimates: Estimates of one robot, keyed by method.
        true_errors: Errors against the truth, keyed by method; None if the truth is unknown.
    """
    truths: dict[str, float] = {}
    for each in (true_errors or {}).values():
        truths |= zip(each.names, each.truth.tolist(), strict=True)
    ordered_estimates = [
        estimates[method] for method in reversed(SIGNALS) if method in estimates
    ]
    names = names_by_influence(ordered_estimates, truths)[:MAX_PARAMETERS]
    errors: dict[Signal, Array] = {}
    sigmas: dict[Signal, Array] = {}
    for method, estimate in estimates.items():
        if true_errors is None:
            errors[method] = _percent_by_name(
                names, estimate, _relative_sigmas(estimate)
            )
        else:
            errors[method] = _percent_by_name(
                names, estimate, np.abs(true_errors[method].relative)
            )
            sigmas[method] = _percent_by_name(
                names, estimate, estimate.sigma / true_errors[method].scale
            )
    return ErrorDots(names, errors, sigmas)


def run_error_dots(run: Run) -> ErrorDots:
    """Relative errors and sigmas of a run's estimates."""
    return error_dots(run.estimates, None if run.score is None else run.score.errors)


def _relative_sigmas(estimate: Estimate) -> Array:
    """Ratios of sigma to absolute value, (p,); nan for values that are zero or exact.

    A value is exact if its sigma is below the relative rounding error `RELATIVE_ROUNDING`.
    """
    size = np.abs(estimate.values)
    known = (size > 0) & (estimate.sigma > RELATIVE_ROUNDING * size)
    return estimate.sigma / np.where(known, size, np.nan)


def _percent_by_name(names: Sequence[str], estimate: Estimate, values: Array) -> Array:
    """Relative values of an estimate in percent, in the order of `names`, (k,).

    The value of a parameter that the estimate lacks is nan.

    Args:
        names: Names of parameters, (k,).
        estimate: The estimate.
        values: Relative values of the estimate's parameters, (p,).
    """
    values_by_name = dict(zip(estimate.names, values.tolist(), strict=True))
    percent = 100 * np.array([values_by_name.get(name, np.nan) for name in names])
    return np.where(np.isfinite(percent), percent, np.nan)


def parameter_error_section(run: Run) -> Section | None:
    """Section with relative errors and sigmas of a run's parameters.

    If the truth is unknown, the section contains relative standard deviations only. The result is
    None if there are no parameters.

    Args:
        run: The run.
    """
    dots = run_error_dots(run)
    if not dots.names:
        return None
    truth_known = bool(dots.sigmas)
    order = "Sorted by influence on the predicted forces"
    order_sentence = (
        f"{order}; these are the first {MAX_PARAMETERS}."
        if len(dots.names) == MAX_PARAMETERS
        else f"{order}."
    )
    quantity = "error" if truth_known else "std"
    rows = np.column_stack([*dots.errors.values()])
    values, bars = dots.dots_and_bars
    return Section(
        id="errors",
        title="Parameter errors"
        if truth_known
        else "Standard deviations of the parameters",
        explanation=(
            "Errors against the truth (dots) and estimated standard deviations (bars). A dot "
            "far outside its bar is a bias."
            if truth_known
            else "Estimated standard deviation divided by the value."
        ),
        legend={method: run.instruments[method] for method in dots.errors},
        panels=named_panels("", dots.names, values, dots.label, bars=bars, log=True),
        caption=f"Logarithmic scale. {order_sentence}",
        table=Table(
            [
                "parameter",
                *(
                    f"{quantity}, {run.instruments[method]} [%]"
                    for method in dots.errors
                ),
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
    """Draw the residuals of a recording over time, or the parameter errors of a run.

    Args:
        what: For a recording, the residuals of each channel are drawn. For a run or an estimate,
            the errors of the parameters are drawn with bars of one standard deviation, or the
            relative standard deviations if the truth is unknown.
        *estimates: Estimates of the recording's robot; ignored for a run or estimate.

    Returns:
        Matplotlib figure; notebooks display it, `savefig` writes it.
    """
    if isinstance(what, Recording):
        return _residual_figure(predict(what, *estimates))
    dots = (
        run_error_dots(what)
        if isinstance(what, Run)
        else error_dots({what.method: what})
    )
    instruments = (
        what.instruments if isinstance(what, Run) else {what.method: what.instrument}
    )
    values, bars = dots.dots_and_bars
    label = f"{dots.label}; bars: one standard deviation" if bars else dots.label
    figure = draw(
        named_panel("", dots.names, values, label, bars=bars, log=True), FIGURE_WIDTH
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


def _residual_figure(predictions: Predictions) -> Picture:
    """Figure of the residuals `measured - predicted` over time, one plot per channel.

    The first channel is the main plot of the panel, the others are lower plots.
    """
    plots = {
        f"{channel.name} [{channel.unit}]": {
            method: (predictions.time, residual)
            for method, residual in channel.residuals.items()
        }
        for channel in predictions.channels
    }
    (title, curves), *below = plots.items()
    return draw(Panel(title, curves, "time [s]", lower_plots=dict(below)), FIGURE_WIDTH)
