"""A campaign for people: what it will do, and errors and coverage cell by cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from testbed.campaigns.campaign import Campaign, Level
from testbed.campaigns.results import Results
from testbed.campaigns.summary import CellSummary, summarise
from testbed.core.base.arrays import Array
from testbed.core.base.errors import plural, printable
from testbed.core.estimation.estimate import NAMES
from testbed.view.figures import named_panels
from testbed.view.output import print_tables, write_page
from testbed.view.section import Section, Table

LISTED = 30
"""Cells or failures that are listed one by one."""

HEADS = ("cell", "estimate", "runs", "error [%]", "coverage [%]", "interval [%]")


def print_plan(out: Console, campaign: Campaign) -> None:
    """Print the cells of a campaign, how many runs they are, and the first one.

    Args:
        out: Where to.
        campaign: The campaign.
    """
    cells, replicates = len(campaign.cells), campaign.tables.replicates
    for cell in campaign.cells[:LISTED]:
        out.print(
            _levels(dict(zip(campaign.factors, cell.levels, strict=True))),
            soft_wrap=True,
        )
    if cells > LISTED:
        out.print(f"... {cells - LISTED} more")
    runs = plural(cells * replicates, "run")
    out.print(
        f"{plural(cells, 'cell')}, {plural(replicates, 'replicate')} each: {runs}"
    )
    out.print(f"the first one: {campaign.command(0, 0)}", soft_wrap=True)


def print_campaign(out: Console, results: Results) -> None:
    """Print the summary of a campaign.

    Args:
        out: Where to.
        results: Content of its table.
    """
    failures = results.failures
    for each in failures[:LISTED]:
        out.print(f"failed: {each['error']}", soft_wrap=True)
        out.print(f"  {each['command']}", soft_wrap=True)
    if len(failures) > LISTED:
        out.print(f"... {len(failures) - LISTED} more, in the table")
    print_tables(out, [_table(summarise(results.rows))])
    out.print(_count(results), soft_wrap=True)


def write_campaign_page(path: Path, results: Results) -> None:
    """Write the page of a campaign.

    Args:
        path: The HTML file; what stands there is replaced.
        results: Content of the campaign's table.
    """
    cells = summarise(results.rows)
    content = {
        "title": results.name,
        "claim": results.claim,
        "summary": _count(results),
        "figures": [cells_figure(cells)] if cells else [],
        "failures": results.failures,
    }
    write_page(path, "campaign.html", content)


def cells_figure(cells: Sequence[CellSummary]) -> Section:
    """Figure of the error and the coverage of every estimate in every cell.

    Args:
        cells: Summary of the campaign.
    """
    names = {each.cell: _levels(each.levels) for each in cells}
    legend = {
        k: label
        for k, label in NAMES.items()
        if any(k == each.estimator for each in cells)
    }
    values = {method: _by_cell(cells, method, list(names)) for method in legend}
    errors = {method: rows[0] for method, rows in values.items()}
    shares = {method: rows[1] for method, rows in values.items()}
    bars = {method: (rows[2], rows[3]) for method, rows in values.items()}
    words = list(names.values())
    coverage = named_panels(
        "coverage", words, shares, "coverage [%]", bars=bars, line=95.0
    )
    return Section(
        id="cells",
        title="Errors and coverage",
        says=(
            "Error: rms relative error of the parameters, median over the runs of a cell. "
            "Coverage: share of the 95 % confidence intervals that contain the truth, and its "
            "own 95 % confidence interval for this number of runs."
        ),
        legend={"measured": "95 %"} | legend,
        panels=named_panels("error", words, errors, "error [%]", log=True) + coverage,
        table=_table(cells),
    )


def _by_cell(
    cells: Sequence[CellSummary], method: str, numbers: Sequence[int]
) -> Array:
    """Error, coverage and its bounds of a method [%], (4, cells); not a number where it lacks."""
    values = np.full((4, len(numbers)), np.nan)
    for each in cells:
        if each.estimator == method:
            column = each.error, each.coverage, *each.bounds
            values[:, numbers.index(each.cell)] = 100 * np.array(column)
    return values


def _table(cells: Sequence[CellSummary]) -> Table:
    rows = []
    for each in cells:
        low, high = each.bounds
        known = each.coverage == each.coverage
        rows.append(
            [
                _levels(each.levels),
                each.estimator,
                str(each.runs),
                f"{100 * each.error:.3g}",
                f"{100 * each.coverage:.1f}" if known else "-",
                f"{100 * low:.1f} to {100 * high:.1f}" if known else "-",
            ]
        )
    return Table(HEADS, rows, left=["estimate"])


def _levels(levels: Mapping[str, Level]) -> str:
    """Levels of a cell by factor, in words."""
    said = (
        f"{name} = {level if isinstance(level, str) else f'{level:g}'}"
        for name, level in levels.items()
    )
    return printable(", ".join(said) or "the experiment as it is")


def _count(results: Results) -> str:
    """Numbers of runs, cells and failures, in words."""
    cells = plural(len({row["cell"] for row in results.rows}), "cell")
    failed = len(results.failures) or "none"
    return f"{plural(len(results.rows), 'run')} in {cells}; {failed} without a result."
