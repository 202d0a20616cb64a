"""A campaign for people: what it will do, how far it is, what it shows; terminal and page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from testbed.campaigns.campaign import Campaign
from testbed.campaigns.conduct import Standing, bytes_of, seconds_of
from testbed.campaigns.results import RESULTS, CampaignFolder
from testbed.campaigns.summary import Change, Figure, ParameterErrors, Summary, pooled
from testbed.core.base.arrays import Array
from testbed.core.base.errors import plural, printable, round_significant
from testbed.core.estimation.estimate import METHODS, NAMES
from testbed.view.figures import Panel, named_panels
from testbed.view.output import Progress, print_tables, write_page
from testbed.view.section import HeatTable, Section, Table

ENOUGH = 20
"""Runs without which no distribution of errors is drawn."""

BINS = np.linspace(-4.0, 4.0, 33)
"""Of scores, in sigmas; what is beyond counts in the outermost ones."""


def marginal_figure(summary: Summary, metrics: Sequence[str]) -> Section | None:
    """Metrics over each factor, the mean over all others.

    Args:
        summary: What the campaign says.
        metrics: Names that begin with the method.
    """
    panels, rows = [], []
    for k, factor in enumerate(summary.factors):
        levels = list(dict.fromkeys(cell[k] for cell in summary.cells.values()))
        named = any(isinstance(level, str) for level in levels)
        curves: dict[str, Array] = {}
        for metric in metrics:
            own = [each for each in summary.figures if each.metric == metric]
            means = [_mean([f for f in own if summary.cells[f.cell][k] == x]) for x in levels]
            if own:
                curves[metric.partition("_")[0]] = 100 * np.array(means)
                rows += [
                    [factor, str(level), metric.replace("_", " "), f"{100 * mean:.3g}"]
                    for level, mean in zip(levels, means, strict=True)
                ]
        title = "rms relative error [%]"
        if named:
            panels += named_panels(factor, [str(level) for level in levels], curves, title)
        else:
            at, log = np.array(levels, dtype=float), all(level > 0 for level in levels)
            shown = {kind: (at, means) for kind, means in curves.items()}
            panels.append(Panel(title, shown, factor, log, tuple(curves)))
    if not panels:
        return None
    return Section(
        id="marginals",
        title="Errors over each factor",
        says="Mean over all runs of a level.",
        legend=_legend(panels),
        panels=panels,
        caption="Rms over the parameters that joint torques can identify.",
        table=Table(["factor", "level", "metric", "mean [%]"], rows),
    )


def _legend(panels: Sequence[Panel]) -> dict[str, str]:
    """Of the methods that are drawn."""
    return {k: label for k, label in NAMES.items() if any(k in each.curves for each in panels)}


def _mean(figures: Sequence[Figure]) -> float:
    runs = sum(each.runs for each in figures)
    return sum(each.mean * each.runs for each in figures) / runs if runs else float("nan")


def coverage_figure(every: Sequence[ParameterErrors]) -> Section | None:
    """Share of intervals of 95 % that hold the truth, parameter by parameter.

    Args:
        every: Errors of all cells together.
    """
    names = list(dict.fromkeys(each.parameter for each in every))
    shares: dict[str, Array] = {}
    bars: dict[str, tuple[Array, Array]] = {}
    rows = []
    for method in METHODS:
        own = {each.parameter: each for each in every if each.method == method}
        if not own:
            continue
        found = np.full((3, len(names)), np.nan)
        for k, name in enumerate(names):
            if name in own:
                found[:, k] = own[name].coverage, *own[name].bounds
        shares[method], *ends = 100 * found
        bars[method] = ends[0], ends[1]
        rows += [
            [each.parameter, method, str(each.runs), f"{100 * each.coverage:.1f}"]
            for each in own.values()
        ]
    if not rows:
        return None
    title = "coverage"
    panels = named_panels(title, names, shares, "coverage [%]", bars=bars, line=95.0)
    return Section(
        id="coverage",
        title="Coverage of 95 % confidence intervals",
        says=(
            "Points: share of the intervals that contain the truth. Bars: 95 % confidence "
            "interval of that share for this number of runs; one bar in twenty may miss the line."
        ),
        legend={"measured": "95 %"} | _legend(panels),
        panels=panels,
        caption="Confidence intervals by Clopper and Pearson.",
        table=Table(["parameter", "method", "runs", "coverage [%]"], rows),
    )


def score_figure(z: Mapping[str, Mapping[str, Array]]) -> Section | None:
    """Errors over sigmas of all parameters beside the normal law; None of fewer than ENOUGH runs.

    Args:
        z: By method and parameter.
    """
    panels: list[Panel] = []
    rows: list[list[str]] = []
    middle = (BINS[1:] + BINS[:-1]) / 2
    normal = np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi)
    for method, every in z.items():
        scores = {name: values for name, values in every.items() if len(values) >= ENOUGH}
        if not scores:
            continue
        rows += [
            [name, method, f"{values.mean():.2f}", f"{_rms(values):.2f}"]
            for name, values in scores.items()
        ]
        pooled = np.concatenate(list(scores.values()))
        inside = np.clip(pooled, BINS[0], BINS[-1])
        share = np.histogram(inside, BINS)[0] / len(pooled) / np.diff(BINS)
        stairs = np.repeat(BINS, 2)[1:-1], np.repeat(share, 2)
        title = f"{NAMES[method]}: density of {len(pooled)} errors, rms {_rms(pooled):.2f}"
        curves = {"measured": (middle, normal), method: stairs}
        panels.append(Panel(title, curves, "error / standard deviation", from_zero=True))
    if not panels:
        return None
    return Section(
        id="scores",
        title="Normalised errors",
        says="Errors divided by standard deviations should follow a standard normal distribution.",
        legend={"measured": "normal distribution"} | _legend(panels),
        panels=panels,
        caption="All parameters and runs together; the table lists each parameter.",
        table=Table(["parameter", "method", "mean of z", "rms of z"], rows),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def sigma_figure(parts: Sequence[ParameterErrors]) -> Section | None:
    """The spread that came out over the sigma that was predicted, a point a parameter and cell.

    Args:
        parts: By cell, method and parameter.
    """
    curves: dict[str, tuple[Array, Array]] = {}
    known = [each for each in parts if each.spread > 0 and each.sigma > 0]
    if not known:
        return None
    ends = np.array([f([each.sigma for each in known]) for f in (min, max)])
    curves["measured"] = ends, ends
    for method in METHODS:
        own = [each for each in known if each.method == method]
        if own:
            curves[method] = np.array([e.sigma for e in own]), np.array([e.spread for e in own])
    points = tuple(kind for kind in curves if kind != "measured")
    panel = Panel(
        "obtained standard deviation",
        curves,
        "predicted standard deviation",
        log=True,
        points=points,
    )
    return Section(
        id="sigma",
        title="Predicted and obtained standard deviation",
        says="Points on the line: the predicted standard deviation is correct.",
        legend={"measured": "as predicted"} | _legend([panel]),
        panels=[panel],
        caption="Each in the unit of its parameter.",
        table=Table(
            ["method", "parameters and cells", "median of obtained over predicted"],
            [
                [m, str(len(curves[m][0])), f"{np.median(curves[m][1] / curves[m][0]):.2f}"]
                for m in points
            ],
        ),
    )


LISTED = 30
"""Cells or failures that are listed one by one."""

SHOWN_METRICS = (
    ("wrench: error [%]", "external_rms_relative_error", 100.0),
    ("largest z", "external_max_z", 1.0),
    ("joint torques: error [%]", "internal_rms_relative_error", 100.0),
    ("its largest z", "internal_max_z", 1.0),
    ("consistent error [%]", "consistent_rms_relative_error", 100.0),
)
"""Heads of columns, what stands in them, means over a cell, and times which they are shown."""

SHOWN = ("external_rms_relative_error", "internal_rms_relative_error")
"""Metrics that are compared on one scale."""

CAPTIONS = {
    **dict(zip(SHOWN, ("Wrench", "Joint torques"), strict=True)),
    "consistent_rms_relative_error": "Consistent bodies",
}
"""Metrics that have a table over two factors, all on one scale."""

HEADS = (
    "parameter", "runs", "truth", "bias", "spread", "rms error", "sigma",
    "coverage [%]", "bounds [%]", "relative rms",
)  # fmt: skip


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
    there = {each.metric for each in summary.figures}
    metrics = [each for each in SHOWN_METRICS if each[1] in there]
    means = {(each.cell, each.metric): each.mean for each in summary.figures}
    rows = []
    for number, levels in list(summary.cells.items())[:LISTED]:
        values = [scale * means.get((number, metric), math.nan) for _, metric, scale in metrics]
        shown = ["-" if math.isnan(x) else f"{round_significant(x, 3):g}" for x in values]
        rows.append([f"{number} {', '.join(map(str, levels)) or '-'}", *shown])
    heads = [name for name, *_ in metrics]
    print_tables(
        out, [Table(["cell", *heads], rows, parts=[[k] for k in range(1, 1 + len(heads))])]
    )
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
    rows = []
    for each in changes:
        sigmas = "-" if math.isnan(each.sigmas) else f"{each.sigmas:+.1f}"
        numbers = (f"{x:.3g}" for x in (each.before, each.after, each.ratio))
        rows.append([", ".join(map(str, each.levels)) or "-", each.metric, *numbers, sigmas])
    heads = ["levels", "metric", "before", "after", "ratio", "sigmas"]
    print_tables(out, [Table(heads, rows, left=["metric"])])
    if not changes:
        out.print("the two campaigns have no cell of the same levels")


def duration(seconds: float) -> str:
    """A time as people say it."""
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.2g} seconds"


def write_campaign_page(path: Path, summary: Summary) -> None:
    """Write the page of a campaign.

    Args:
        path: The HTML file; what stands there is replaced.
        summary: What the campaign says.
    """
    write_page(path, "campaign.html", campaign_contents(summary))


def campaign_contents(summary: Summary) -> dict[str, Any]:
    """All that the page shows.

    Args:
        summary: What the campaign says.
    """
    every = pooled(summary.parameters)
    figures = [
        marginal_figure(summary, SHOWN),
        coverage_figure(every),
        score_figure(summary.z),
        sigma_figure(summary.parameters),
    ]
    return {
        "title": str(summary.about.get("name", "campaign")),
        "claim": str(summary.about.get("claim", "")),
        "summary": list(sentences(summary, every)),
        "heats": list(_heats(summary)),
        "factors": summary.factors,
        "figures": [figure for figure in figures if figure is not None],
        "tables": [
            Table(HEADS, rows, f"By the {method} method, all cells together")
            for method in METHODS
            if (rows := [_row(each) for each in every if each.method == method])
        ],
        "failures": [{"command": command, "error": error} for command, error in summary.failures],
    }


def _heats(summary: Summary) -> Iterator[HeatTable]:
    """The shown metrics over the first two factors, on one scale."""
    if len(summary.factors) != 2:
        return
    levels = [list(dict.fromkeys(cell[k] for cell in summary.cells.values())) for k in range(2)]
    if len(levels[0]) * len(levels[1]) != len({*summary.cells.values()}):
        return  # points, no grid
    where = {cell: number for number, cell in summary.cells.items()}
    means = {(each.metric, each.cell): each.mean for each in summary.figures}
    grids = {
        metric: [[means.get((metric, where[a, b]), math.nan) for b in levels[1]] for a in levels[0]]
        for metric in CAPTIONS
        if any((metric, number) in means for number in where.values())
    }
    there = [x for grid in grids.values() for line in grid for x in line if x > 0]
    if not there:
        return
    names, columns = ([_level(level) for level in each] for each in levels)
    for metric, grid in grids.items():
        caption = CAPTIONS[metric]
        yield HeatTable.of_powers(caption, names, columns, grid, min(there), max(there))


def _level(level: float | str) -> str:
    return level if isinstance(level, str) else f"{level:g}"


def _row(each: ParameterErrors) -> list[str]:
    low, high = each.bounds
    return [
        each.parameter,
        str(each.runs),
        f"{each.truth:.4g}",
        f"{each.bias:.2g} +- {each.bias_error:.1g}",
        f"{each.spread:.2g}",
        f"{each.rms:.2g}",
        f"{each.sigma:.2g}",
        f"{100 * each.coverage:.1f}",
        f"{100 * low:.1f} to {100 * high:.1f}",
        f"{each.relative_rms:.2%}",
    ]
