"""Terminal output of estimates, force-plate calibrations and runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.box import ROUNDED
from rich.console import Console
from rich.panel import Panel

from testbed.bodies.prediction_errors import LEAST_SQUARES, POSTERIOR
from testbed.bodies.verdict import WELL_CODE, verdict_of
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import printable_line
from testbed.core.base.summary_table import UNKNOWN_PLATE_ZERO
from testbed.core.estimation.diagnostics.torques import diagnostics_of_estimates
from testbed.lab.experiment.summary import (
    accuracy_lines,
    determined_parameter_lines,
    headline,
)
from testbed.view.bodies import consistent_lines, consistent_tables
from testbed.view.drives import drive_lines, drive_table
from testbed.view.estimates import (
    choice_lines,
    fit_quality_lines,
    parameter_tables,
    plate_coefficient_lines,
    plate_matrix_table,
)
from testbed.view.output import (
    console,
    print_diagnostics,
    print_lines,
    print_result,
    print_tables,
)
from testbed.view.posterior import posterior_table, prediction_error_table

if TYPE_CHECKING:
    from testbed.applications.calibration import Calibration
    from testbed.bodies.consistency.consistent import Consistent
    from testbed.bodies.posterior import Posterior
    from testbed.core.estimation.estimate import Estimate
    from testbed.lab.experiment.run import Run


LEGEND = "mbar mass, mb first moments, K inertia, * with bodies beyond it (docs/conventions.md)"
"""Explanation of the names of base parameters."""

MAX_ROWS = 10
"""Largest number of printed parameters, unless all are requested."""


def print_estimates(
    estimates: list[Estimate],
    diagnostics: Sequence[Diagnostic],
    bodies: Consistent | None = None,
    *,
    posteriors: Sequence[Posterior] = (),
    least_squares: bool = False,
    everything: bool = False,
) -> None:
    """Print the estimates from one recording: verdict, diagnostics, parameters, bodies.

    Diagnostics of single columns come first, since others may be consequences of these. For methods
    whose prior is needed, the posterior is tabulated; for the others, the least-squares estimate.

    Args:
        estimates: Estimates from one recording, one per method.
        diagnostics: Diagnostics of the robot and the recording.
        bodies: Bodies consistent with the estimates; None if not requested.
        posteriors: Estimates from an imported recording with the model file as prior.
        least_squares: True to report the least-squares estimates instead of the posteriors.
        everything: True to print all parameters, all warnings, and the fit of each estimate.
    """
    out = console()
    reported_posteriors = [] if least_squares else list(posteriors)
    verdict = verdict_of(
        estimates,
        posteriors,
        LEAST_SQUARES if least_squares else POSTERIOR,
        diagnostics,
    )
    is_well = verdict[0].code == WELL_CODE
    remaining = [*diagnostics, *diagnostics_of_estimates(estimates)]
    print_diagnostics(
        out, filter(_is_column_diagnostic, remaining)
    )  # other diagnostics may follow from these
    remaining = [each for each in remaining if not _is_column_diagnostic(each)]
    if not is_well:
        print_diagnostics(out, verdict, None if everything or posteriors else 1)
        printed = {(each.code, each.subject) for each in verdict}
        remaining = [
            each for each in remaining if (each.code, each.subject) not in printed
        ]
    evidence = [f"{each.text}." for each in verdict if is_well]
    if summary := [
        *evidence,
        *determined_parameter_lines(reported_posteriors, without_reservations=is_well),
    ]:
        out.print(Panel(printable_line(" ".join(summary)), box=ROUNDED))
    print_diagnostics(out, remaining, None if everything else int(is_well))
    used_posteriors = [each for each in reported_posteriors if each.used]
    rows = None if everything else MAX_ROWS
    print_tables(out, [posterior_table(each, rows) for each in used_posteriors])
    least_squares_estimates = [
        estimate
        for estimate in estimates
        if estimate.method not in {each.method for each in used_posteriors}
    ]
    _print_parameters(out, least_squares_estimates, {}, everything=everything)
    if used_posteriors and not least_squares_estimates:
        out.print(LEGEND)
    for each in posteriors:
        print_tables(out, [prediction_error_table(errors) for errors in each.errors])
    lines = choice_lines(estimates)
    print_lines(out, [*fit_quality_lines(estimates), *lines] if everything else lines)
    if bodies is not None:
        print_tables(out, consistent_tables(bodies))
        print_lines(out, map(printable_line, consistent_lines(bodies)))


def _is_column_diagnostic(diagnostic: Diagnostic) -> bool:
    """Test whether a diagnostic concerns a single column of a recording."""
    return "-column." in diagnostic.code


def _print_parameters(
    out: Console,
    estimates: Sequence[Estimate],
    truths: Mapping[str, float],
    title: str = "",
    *,
    everything: bool,
) -> None:
    """Print the `MAX_ROWS` parameters with most influence on the signals, or all parameters.

    Lines on unidentifiable parameters and on the number of omitted parameters follow, then
    `LEGEND`. Nothing is printed if there are no estimates.

    Args:
        out: Console of the output.
        estimates: Estimates from one recording, one per method.
        truths: True values by name; {} if unknown.
        title: Title of the table.
        everything: True to print all parameters.
    """
    if not estimates:
        return
    max_rows = None if everything else MAX_ROWS
    print_tables(out, *parameter_tables(estimates, truths, title, max_rows))
    for name in (name for estimate in estimates for name in estimate.unidentifiable):
        out.print(f"{printable_line(name)} is {UNKNOWN_PLATE_ZERO}")
    count = len({name for estimate in estimates for name in estimate.names}) - MAX_ROWS
    if not everything and count > 0:
        out.print(f"({count} more parameters with less influence: --all)")
    out.print(LEGEND)


def print_plate(
    plate: Calibration, diagnostics: Sequence[Diagnostic], path: Path
) -> None:
    """Print a force plate's calibration: matrix, other coefficients, estimate, diagnostics.

    Args:
        plate: The calibration, with the estimate.
        diagnostics: Diagnostics of the robot.
        path: File to which the calibration was written.
    """
    out = console()
    print_result([plate_matrix_table(plate)], plate_coefficient_lines(plate))
    estimates = [] if plate.estimate is None else [plate.estimate]
    if estimates:
        print_tables(out, *parameter_tables(estimates, {}))
    print_diagnostics(
        out,
        [*diagnostics, *(d for estimate in estimates for d in estimate.diagnostics)],
    )
    out.print(f"plate: {path}")


def print_run(run: Run, folder: Path, *, everything: bool = False) -> None:
    """Print the result of an experiment: verdict, diagnostics, parameters, bodies, drives.

    Args:
        run: Run of the experiment.
        folder: Folder of the run.
        everything: True to print all parameters, metrics and warnings.
    """
    out = console()
    estimates = list(run.estimates.values())
    out.print(Panel(printable_line(headline(run)), box=ROUNDED))
    print_lines(
        out, map(printable_line, accuracy_lines(run)[: None if everything else 1])
    )
    _print_verdict(out, run)
    print_diagnostics(out, run.diagnostics, None if everything else 1)
    _print_parameters(out, estimates, run.truths, run.name, everything=everything)
    if everything:
        print_lines(out, fit_quality_lines(estimates))
    if run.consistent is not None:
        print_lines(out, map(printable_line, consistent_lines(run.consistent)))
    if run.drives is not None:
        print_tables(out, [drive_table(run.drives.estimates)])
        print_lines(out, drive_lines(run.drives))
    if everything:
        _print_metrics(out, run, dict.fromkeys((*run.metrics, *run.verdicts)))
    out.print(f"run folder: {folder}")


def _print_metrics(out: Console, run: Run, names: Iterable[str]) -> None:
    """Print one line per metric: name, value, and the bound of [expect].

    A missing value is printed as "none". A bound is followed by "holds" or "FAILS"; metrics without
    a bound have neither.

    Args:
        out: Console of the output.
        run: Run with the metrics.
        names: Names of the printed metrics.
    """
    expect = {} if run.experiment is None else run.experiment.expect
    for name in names:
        value = f"{run.metrics[name]:9.3g}" if name in run.metrics else "     none"
        claim = ""
        if name in expect:
            claim = f"  {expect[name].description}: {'holds' if run.verdicts[name] else 'FAILS'}"
        out.print(f"{name:28s}{value}{claim}")


def _print_verdict(out: Console, run: Run) -> None:
    """Print the claim of an experiment, and which of its bounds hold.

    The output is the number of satisfied bounds and the violated bounds. Nothing is printed for a
    run without bounds.
    """
    if run.experiment is None or not run.experiment.expect:
        return
    satisfied, count = sum(run.verdicts.values()), len(run.experiment.expect)
    if run.experiment.claim:
        out.print(f"claim: {printable_line(run.experiment.claim)}")
    verdict = "the claim holds" if satisfied == count else "THE CLAIM FAILS"
    out.print(f"verdict: {verdict} ({satisfied} of {count} bounds)")
    _print_metrics(
        out, run, [name for name, holds in run.verdicts.items() if not holds]
    )
