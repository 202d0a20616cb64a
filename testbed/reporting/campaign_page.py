"""A campaign as a page: errors over its factors, whether sigma is honest, what failed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from testbed.campaign.summary import ParameterErrors, Summary, pooled
from testbed.files import replacing
from testbed.identification.estimate import METHODS
from testbed.reporting.campaign_figures import (
    coverage_figure,
    marginal_figure,
    score_figure,
    sigma_figure,
)
from testbed.reporting.campaign_lines import sentences
from testbed.reporting.heat_table import heat_table
from testbed.reporting.html import rendered

SHOWN = ("external_rms_relative_error", "internal_rms_relative_error")
"""Metrics that are compared on one scale."""

CAPTIONS = {
    **dict(zip(SHOWN, ("By the plate", "By joint torques"), strict=True)),
    "consistent_rms_relative_error": "Bodies that can exist",
}
"""Metrics that have a table over two factors, all on one scale."""

HEADS = (
    "parameter", "runs", "truth", "bias", "spread", "rms error", "sigma",
    "coverage [%]", "bounds [%]", "relative rms",
)  # fmt: skip


def write_campaign_page(path: Path, summary: Summary) -> None:
    """Write the page of a campaign.

    Args:
        path: The HTML file; what stands there is replaced.
        summary: What the campaign says.
    """
    text = rendered("campaign.html", campaign_contents(summary))
    with replacing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")


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
        "heads": HEADS,
        "tables": [
            {"caption": f"By the {method} method, all cells together", "rows": rows}
            for method in METHODS
            if (rows := [_row(each) for each in every if each.method == method])
        ],
        "failures": [{"command": command, "error": error} for command, error in summary.failures],
    }


def _heats(summary: Summary) -> Iterator[dict[str, Any]]:
    """The shown metrics over the first two factors, on one scale."""
    if len(summary.factors) != 2:
        return
    levels = [list(dict.fromkeys(cell[k] for cell in summary.cells.values())) for k in range(2)]
    if len(levels[0]) * len(levels[1]) != len(summary.cells):
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
        yield heat_table(caption, names, columns, grid, min(there), max(there))


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
