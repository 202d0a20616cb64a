"""A campaign on the terminal: what it will do, how far it is, what failed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from testbed.campaign.campaign import Campaign
from testbed.campaign.conduct import Standing, bytes_of, seconds_of
from testbed.campaign.results import RESULTS, CampaignFolder
from testbed.campaign.summary import Change, ParameterErrors, Summary, pooled
from testbed.errors import plural, printable, round_significant
from testbed.identification.estimate import METHODS
from testbed.reporting.output import Progress

LISTED = 20
"""Cells or failures that are listed one by one."""

SHOWN_METRICS = (
    ("external error [%]", "external_rms_relative_error", 100.0),
    ("largest z", "external_max_z", 1.0),
    ("internal error [%]", "internal_rms_relative_error", 100.0),
    ("its largest z", "internal_max_z", 1.0),
    ("consistent error [%]", "consistent_rms_relative_error", 100.0),
)
"""Heads of columns, what stands in them, means over a cell, and times which they are shown."""


def sentences(summary: Summary, every: Sequence[ParameterErrors]) -> Iterator[str]:
    """What a person reads first.

    Args:
        summary: What a campaign says.
        every: Its errors, all cells together.
    """
    cells, failed = len(summary.cells), len(summary.failures)
    varied = " over " + ", ".join(summary.factors) if summary.factors else ""
    made = plural(summary.runs, "run")
    yield f"{made} in {plural(cells, 'cell')}{varied}; {failed or 'none'} without a result."
    for method in METHODS:
        own = [each for each in every if each.method == method]
        if own:
            inside, runs = sum(each.inside for each in own), sum(each.runs for each in own)
            yield f"Of {runs} intervals of 95 %, {method}, {inside / runs:.1%} hold the truth."


class Throughput(Progress):
    """How far a campaign is."""

    def __init__(self) -> None:
        """Nothing done yet."""
        super().__init__("runs")

    def of(self, standing: Standing) -> None:
        """Show how far it is."""
        failed = f", {standing.failed} failed" if standing.failed else ""
        words = (
            f"{standing.done} of {plural(standing.total, 'run')}{failed}, "
            f"{standing.rate:.3g} a second"
        )
        left = (standing.total - standing.done) / max(standing.rate, 1e-9)
        self.say(standing.done, standing.total, f"{words}, {duration(left)} left")


def print_plan(out: Console, campaign: Campaign, folder: Path, limit: int | None) -> None:
    """Print what a campaign will do, and roughly what it costs.

    Args:
        out: Where to.
        campaign: The campaign.
        folder: Where its table will be.
        limit: Runs that are done, if not all.
    """
    cells, replicates = len(campaign.cells), campaign.tables.replicates
    for number, cell in enumerate(campaign.cells[:LISTED]):
        levels = zip(campaign.factors, cell.levels, strict=True)
        said = ", ".join(f"{name} = {level}" for name, level in levels)
        out.print(printable(f"cell {number}: {said or 'the experiment as it is'}"), soft_wrap=True)
    if cells > LISTED:
        out.print(f"... {cells - LISTED} more")
    runs = min(limit or campaign.runs, campaign.runs)
    first = campaign.experiment(0, 0)
    keeps = campaign.tables.recordings == "keep"
    seconds = sum(seconds_of(campaign.experiment(cell, 0)) for cell in range(cells)) / cells
    megabytes = runs * bytes_of(first, keeps=keeps) / 1e6
    at_most = "at most " if campaign.tables.stop is not None else ""
    out.print(
        f"{plural(cells, 'cell')}, {plural(replicates, 'replicate')} each: "
        f"{at_most}{plural(runs, 'run')}"
    )
    out.print(f"about {duration(runs * seconds)} of one processor, {megabytes:.3g} MB in {folder}")
    out.print(f"the first one: {campaign.command(0, 0)}", soft_wrap=True)


def print_conducted(out: Console, folder: CampaignFolder) -> int:
    """Print what came of a campaign.

    Args:
        out: Where to.
        folder: Its folder.

    Returns:
        How many runs failed.
    """
    failures = folder.failures()
    for command, error in failures[:LISTED]:
        out.print(printable(f"failed: {error}"), soft_wrap=True)
        out.print(f"  {command}", soft_wrap=True)
    if len(failures) > LISTED:
        out.print(f"... {len(failures) - LISTED} more, in the table")
    there = len(folder.status) - len(failures)
    out.print(f"{plural(there, 'run')} with a result, {len(failures)} without", soft_wrap=True)
    out.print(f"table: {folder.path / RESULTS}", soft_wrap=True)
    return len(failures)


def print_summary(out: Console, summary: Summary, files: Sequence[Path]) -> None:
    """Print what a campaign says.

    Args:
        out: Where to.
        summary: What it says.
        files: That say the same, and more.
    """
    for line in sentences(summary, pooled(summary.parameters)):
        out.print(printable(line), soft_wrap=True)
    table = Table(box=None, pad_edge=False)
    there = {each.metric for each in summary.figures}
    metrics = [each for each in SHOWN_METRICS if each[1] in there]
    for head in ("cell", "levels", *(name for name, *_ in metrics)):
        table.add_column(head, justify="left" if head == "levels" else "right", overflow="fold")
    means = {(each.cell, each.metric): each.mean for each in summary.figures}
    for number, levels in list(summary.cells.items())[:LISTED]:
        values = [scale * means.get((number, metric), math.nan) for _, metric, scale in metrics]
        said = ", ".join(map(str, levels)) or "-"
        shown = (
            "-" if math.isnan(value) else f"{round_significant(value, 3):g}" for value in values
        )
        table.add_row(str(number), printable(said), *shown)
    out.print(table)
    if len(summary.cells) > LISTED:
        out.print(f"... {len(summary.cells) - LISTED} cells more")
    for file in files:
        out.print(str(file), soft_wrap=True)


def print_changes(out: Console, changes: Sequence[Change]) -> None:
    """Print how the metrics of two campaigns differ, cell by cell.

    Args:
        out: Where to.
        changes: What differs.
    """
    table = Table(box=None, pad_edge=False)
    for head in ("levels", "metric", "before", "after", "ratio", "sigmas"):
        table.add_column(head, justify="left" if head in ("levels", "metric") else "right")
    for each in changes:
        sigmas = "-" if math.isnan(each.sigmas) else f"{each.sigmas:+.1f}"
        levels = printable(", ".join(map(str, each.levels)) or "-")
        numbers = (f"{x:.3g}" for x in (each.before, each.after, each.ratio))
        table.add_row(levels, each.metric, *numbers, sigmas)
    out.print(table)
    if not changes:
        out.print("the two campaigns have no cell of the same levels")


def duration(seconds: float) -> str:
    """A time as people say it."""
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.2g} seconds"
