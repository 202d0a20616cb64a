"""What the terminal shows of estimates and runs: tables and lines."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.box import ROUNDED
from rich.console import Console
from rich.panel import Panel

from testbed.bodies.prediction_errors import PLAIN, POSTERIOR
from testbed.bodies.verdict import WELL, verdict_of
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import printable
from testbed.core.base.summary_table import OPEN_ZERO
from testbed.core.estimation.diagnostics.torques import diagnostics_of
from testbed.lab.experiment.summary import accuracy_lines, data_lines, headline
from testbed.view.bodies import consistent_lines, consistent_tables
from testbed.view.drives import drive_lines, drive_table
from testbed.view.estimates import (
    choice_lines,
    parameter_tables,
    plate_lines,
    plate_table,
    quality_lines,
)
from testbed.view.output import (
    console,
    print_diagnostics,
    print_result,
    print_tables,
    print_text,
)
from testbed.view.posterior import errors_table, posterior_table

if TYPE_CHECKING:
    from testbed.applications.calibration import Calibration
    from testbed.bodies.consistency.consistent import Consistent
    from testbed.bodies.posterior import Posterior
    from testbed.core.estimation.estimate import Estimate
    from testbed.lab.experiment.run import Run


LEGEND = "mbar mass, mb first moments, K inertia, * with bodies beyond it (docs/conventions.md)"
"""What names of base parameters mean."""

ROWS = 10
"""Parameters that are shown where not all are asked for."""


def print_estimates(
    estimates: list[Estimate],
    diagnostics: Sequence[Diagnostic],
    bodies: Consistent | None = None,
    *,
    posteriors: Sequence[Posterior] = (),
    plain: bool = False,
    everything: bool = False,
) -> None:
    """Print what was found.

    Args:
        estimates: Of one recording.
        diagnostics: About the robot and the recording.
        bodies: Consistent with the estimates, where they were asked for.
        posteriors: With the model file as prior, of an imported recording.
        plain: Whether least squares come first all the same.
        everything: Whether all parameters and warnings are printed.
    """
    out = console()
    first = [] if plain else list(posteriors)
    said = verdict_of(estimates, posteriors, PLAIN if plain else POSTERIOR, diagnostics)
    well = said[0].code == WELL
    others = [*diagnostics, *diagnostics_of(estimates)]
    print_diagnostics(out, filter(_of_column, others))  # others may follow from them
    others = [each for each in others if not _of_column(each)]
    if not well:
        print_diagnostics(out, said, None if everything or posteriors else 1)
        known = {(each.code, each.subject) for each in said}
        others = [each for each in others if (each.code, each.subject) not in known]
    evidence = [f"{each.text}." for each in said if well]
    if summary := [*evidence, *data_lines(first, well=well)]:
        out.print(Panel(printable(" ".join(summary)), box=ROUNDED))
    print_diagnostics(out, others, None if everything else int(well))
    needed = [each for each in first if each.used]
    rows = None if everything else ROWS
    print_tables(out, [posterior_table(each, rows) for each in needed])
    left = [e for e in estimates if e.method not in {each.method for each in needed}]
    _print_parameters(out, left, {}, everything=everything)
    if needed and not left:
        out.print(LEGEND)
    for each in posteriors:
        print_tables(out, [errors_table(errors) for errors in each.errors])
    lines = choice_lines(estimates)
    print_text(out, [*quality_lines(estimates), *lines] if everything else lines)
    if bodies is not None:
        print_tables(out, consistent_tables(bodies))
        print_text(out, map(printable, consistent_lines(bodies)))


def _of_column(diagnostic: Diagnostic) -> bool:
    """Whether it is of what a single column of a recording shows."""
    return "-column." in diagnostic.code


def _print_parameters(
    out: Console,
    estimates: Sequence[Estimate],
    truths: Mapping[str, float],
    title: str = "",
    *,
    everything: bool,
) -> None:
    """The parameters that add most to the predicted signals, or all."""
    if not estimates:
        return
    most = None if everything else ROWS
    print_tables(out, *parameter_tables(estimates, truths, title, most))
    for name in (name for e in estimates for name in e.unidentifiable):
        out.print(f"{printable(name)} is {OPEN_ZERO}")
    count = len({name for e in estimates for name in e.names}) - ROWS
    if not everything and count > 0:
        out.print(f"({count} more parameters with less influence: --all)")
    out.print(LEGEND)


def print_plate(
    plate: Calibration, diagnostics: Sequence[Diagnostic], path: Path
) -> None:
    """Print the calibration of a plate.

    Args:
        plate: The calibration, with the estimate.
        diagnostics: About the robot.
        path: Where it is kept.
    """
    out = console()
    print_result([plate_table(plate)], plate_lines(plate))
    estimates = [] if plate.estimate is None else [plate.estimate]
    if estimates:
        print_tables(out, *parameter_tables(estimates, {}))
    print_diagnostics(
        out, [*diagnostics, *(d for e in estimates for d in e.diagnostics)]
    )
    out.print(f"plate: {path}")


def print_run(run: Run, folder: Path, *, everything: bool = False) -> None:
    """Print what came of an experiment.

    Args:
        run: What came of it.
        folder: Where it is kept.
        everything: Whether all parameters, metrics and warnings are printed.
    """
    out = console()
    estimates = list(run.estimates.values())
    out.print(Panel(printable(headline(run)), box=ROUNDED))
    print_text(out, map(printable, accuracy_lines(run)[: None if everything else 1]))
    _print_verdict(out, run)
    print_diagnostics(out, run.diagnostics, None if everything else 1)
    _print_parameters(out, estimates, run.truths, run.name, everything=everything)
    if everything:
        print_text(out, quality_lines(estimates))
    if run.consistent is not None:
        print_text(out, map(printable, consistent_lines(run.consistent)))
    if run.drives is not None:
        print_tables(out, [drive_table(run.drives.estimates)])
        print_text(out, drive_lines(run.drives))
    if everything:
        _print_metrics(out, run, dict.fromkeys((*run.metrics, *run.verdicts)))
    out.print(f"run folder: {folder}")


def _print_metrics(out: Console, run: Run, names: Iterable[str]) -> None:
    """Metrics, and what was claimed of them."""
    expect = {} if run.experiment is None else run.experiment.expect
    for name in names:
        value = f"{run.metrics[name]:9.3g}" if name in run.metrics else "     none"
        claim = ""
        if name in expect:
            claim = (
                f"  {expect[name].wanted}: {'holds' if run.verdicts[name] else 'FAILS'}"
            )
        out.print(f"{name:28s}{value}{claim}")


def _print_verdict(out: Console, run: Run) -> None:
    """The claim, and whether it holds."""
    if run.experiment is None or not run.experiment.expect:
        return
    held, count = sum(run.verdicts.values()), len(run.experiment.expect)
    if run.experiment.claim:
        out.print(f"claim: {printable(run.experiment.claim)}")
    said = "the claim holds" if held == count else "THE CLAIM FAILS"
    out.print(f"verdict: {said} ({held} of {count} bounds)")
    _print_metrics(
        out, run, [name for name, holds in run.verdicts.items() if not holds]
    )
