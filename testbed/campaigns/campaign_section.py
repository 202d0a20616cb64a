"""Terminal output and page of a campaign: plan, errors and coverage cell by cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from testbed.campaigns.campaign import Campaign, Level
from testbed.campaigns.results import Results
from testbed.campaigns.summary import CellSummary, summarise
from testbed.core.base.arrays import Array
from testbed.core.base.errors import count_with_noun, printable_line
from testbed.core.estimation.estimate import METHOD_LABELS
from testbed.view.figures import named_panels
from testbed.view.output import print_tables, write_page
from testbed.view.section import Section, Table

MAX_LISTED = 30
"""Largest number of cells or failures that are listed."""

COLUMN_HEADS = ("cell", "estimate", "runs", "error [%]", "coverage [%]", "interval [%]")
"""Column heads of the table of cells."""


def print_plan(out: Console, campaign: Campaign) -> None:
    """Print the plan of a campaign.

    It consists of the first `MAX_LISTED` cells, the numbers of cells and runs, and the command of
    the first run.

    Args:
        out: Console.
        campaign: The campaign.
    """
    cells, replicates = len(campaign.cells), campaign.tables.replicates
    for cell in campaign.cells[:MAX_LISTED]:
        out.print(
            _levels_text(dict(zip(campaign.factors, cell.levels, strict=True))),
            soft_wrap=True,
        )
    if cells > MAX_LISTED:
        out.print(f"... {cells - MAX_LISTED} more")
    runs = count_with_noun(cells * replicates, "run")
    out.print(
        f"{count_with_noun(cells, 'cell')}, {count_with_noun(replicates, 'replicate')} each: {runs}"
    )
    out.print(f"the first one: {campaign.command(0, 0)}", soft_wrap=True)


def print_campaign(out: Console, results: Results) -> None:
    """Print the first `MAX_LISTED` failed runs of a campaign, and its summary by cell.

    Args:
        out: Console.
        results: Content of the campaign's table.
    """
    failures = results.failures
    for failure in failures[:MAX_LISTED]:
        out.print(f"failed: {failure['error']}", soft_wrap=True)
        out.print(f"  {failure['command']}", soft_wrap=True)
    if len(failures) > MAX_LISTED:
        out.print(f"... {len(failures) - MAX_LISTED} more, in the table")
    print_tables(out, [_summary_table(summarise(results.rows))])
    out.print(_count_text(results), soft_wrap=True)


def write_campaign_page(path: Path, results: Results) -> None:
    """Write the HTML page of a campaign: claim, errors and coverage by cell, failed runs.

    Args:
        path: The HTML file; it is replaced if it exists.
        results: Content of the campaign's table.
    """
    cells = summarise(results.rows)
    content = {
        "title": results.name,
        "claim": results.claim,
        "summary": _count_text(results),
        "figures": [cells_figure(cells)] if cells else [],
        "failures": results.failures,
    }
    write_page(path, "campaign.html", content)


def cells_figure(cells: Sequence[CellSummary]) -> Section:
    """Figure of error and coverage for each cell, in a different colour for each estimator.

    The section also contains the table of these values.

    Args:
        cells: Summary of the campaign by cell and estimator.
    """
    names = {each.cell: _levels_text(each.levels) for each in cells}
    legend = {
        k: label
        for k, label in METHOD_LABELS.items()
        if any(k == each.estimator for each in cells)
    }
    values = {method: _cell_values(cells, method, list(names)) for method in legend}
    errors = {method: rows[0] for method, rows in values.items()}
    shares = {method: rows[1] for method, rows in values.items()}
    bars = {method: (rows[2], rows[3]) for method, rows in values.items()}
    labels = list(names.values())
    coverage = named_panels(
        "coverage", labels, shares, "coverage [%]", bars=bars, line=95.0
    )
    return Section(
        id="cells",
        title="Errors and coverage",
        explanation=(
            "Error: rms relative error of the parameters, median over the runs of a cell. "
            "Coverage: share of the 95 % confidence intervals that contain the truth, and its "
            "own 95 % confidence interval for this number of runs."
        ),
        legend={"measured": "95 %"} | legend,
        panels=named_panels("error", labels, errors, "error [%]", log=True) + coverage,
        table=_summary_table(cells),
    )


def _cell_values(
    cells: Sequence[CellSummary], method: str, numbers: Sequence[int]
) -> Array:
    """Error, coverage, and bounds of the coverage's confidence interval [%], (4, cells).

    Columns of cells without this estimator are NaN.

    Args:
        cells: Summary of the campaign.
        method: Name of the estimator.
        numbers: Indices of the cells, in the order of the columns.
    """
    values = np.full((4, len(numbers)), np.nan)
    for each in cells:
        if each.estimator == method:
            column = each.error, each.coverage, *each.bounds
            values[:, numbers.index(each.cell)] = 100 * np.array(column)
    return values


def _summary_table(cells: Sequence[CellSummary]) -> Table:
    """Table of error and coverage by cell and estimator, with the heads `COLUMN_HEADS`."""
    rows = []
    for each in cells:
        low, high = each.bounds
        known = each.coverage == each.coverage
        rows.append(
            [
                _levels_text(each.levels),
                each.estimator,
                str(each.runs),
                f"{100 * each.error:.3g}",
                f"{100 * each.coverage:.1f}" if known else "-",
                f"{100 * low:.1f} to {100 * high:.1f}" if known else "-",
            ]
        )
    return Table(COLUMN_HEADS, rows, left=["estimate"])


def _levels_text(levels: Mapping[str, Level]) -> str:
    """Text of a cell's levels: "factor = level", separated by commas.

    The text is "the experiment as it is" if there are no factors.
    """
    parts = (
        f"{name} = {level if isinstance(level, str) else f'{level:g}'}"
        for name, level in levels.items()
    )
    return printable_line(", ".join(parts) or "the experiment as it is")


def _count_text(results: Results) -> str:
    """Sentence with the numbers of runs, cells and failures."""
    cells = count_with_noun(len({row["cell"] for row in results.rows}), "cell")
    failed = len(results.failures) or "none"
    return f"{count_with_noun(len(results.rows), 'run')} in {cells}; {failed} without a result."
