"""A campaign's summary as tables for other programs, and beside another campaign's."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from testbed.campaign.campaign_summary import Summary
from testbed.files import replacing


def write_summary(summary: Summary, folder: Path) -> list[Path]:
    """Write what a summary says, as Parquet and as CSV.

    Args:
        summary: The summary.
        folder: Where to.

    Returns:
        The files: parameters and figures, each twice.
    """
    parts = {"parameters": _parameter_rows(summary), "figures": _figure_rows(summary)}
    written = []
    for name, rows in parts.items():
        table = pa.Table.from_pylist(rows) if rows else pa.table({})
        for ending in ("parquet", "csv"):
            path = folder / f"{name}.{ending}"
            with replacing(path) as fresh:
                if ending == "csv":
                    pc.write_csv(table, fresh)
                else:
                    pq.write_table(table, fresh)
            written.append(path)
    return written


def _levels(summary: Summary, cell: int) -> dict[str, Any]:
    return {
        f"factor/{name}": level
        for name, level in zip(summary.factors, summary.cells[cell], strict=True)
    }


def _parameter_rows(summary: Summary) -> list[dict[str, Any]]:
    rows = []
    for each in summary.parameters:
        low, high = each.bounds
        more = {"coverage": each.coverage, "coverage_low": low, "coverage_high": high}
        rows.append(_levels(summary, each.cell) | asdict(each) | more)
    return rows


def _figure_rows(summary: Summary) -> list[dict[str, Any]]:
    return [_levels(summary, each.cell) | asdict(each) for each in summary.figures]


@dataclass(frozen=True)
class Change:
    """A metric in one cell of two campaigns.

    Attributes:
        levels: Of the factors.
        metric: Its name.
        before: Its mean in the first campaign.
        after: In the second.
        ratio: After over before.
        sigmas: Difference of the means over its standard error; not a number without replicates.
    """

    levels: tuple[Any, ...]
    metric: str
    before: float
    after: float
    ratio: float
    sigmas: float


def changes(before: Summary, after: Summary) -> Iterator[Change]:
    """Metrics of two campaigns, where they have cells of the same levels.

    Args:
        before: The first.
        after: The second.
    """
    known = {(before.cells[each.cell], each.metric): each for each in before.figures}
    for new in after.figures:
        levels = after.cells[new.cell]
        old = known.get((levels, new.metric))
        if old is None:
            continue
        error = math.hypot(old.error, new.error)
        gap = new.mean - old.mean
        same = 0.0 if gap == 0 else math.nan
        yield Change(
            levels=levels,
            metric=new.metric,
            before=old.mean,
            after=new.mean,
            ratio=new.mean / old.mean if old.mean else math.nan,
            sigmas=gap / error if np.isfinite(error) and error > 0 else same,
        )
