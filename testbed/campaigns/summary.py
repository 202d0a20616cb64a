"""Errors and coverage of a campaign, cell by cell."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np
from scipy import stats

from testbed.campaigns.campaign import Level
from testbed.core.estimation.estimate import METHODS

ESTIMATORS = (*METHODS, "consistent")
"""Estimators that have a metric of their errors."""

Row = Mapping[str, Any]
"""A row of a campaign's table."""


@dataclass(frozen=True)
class CellSummary:
    """One estimator over the replicates of one cell.

    Attributes:
        cell: Number of the cell.
        levels: Levels of the factors, by name.
        estimator: A method, or "consistent".
        runs: Number of runs with this estimate.
        error: Median of the rms relative errors.
        coverage: Share of the intervals of 95 % that hold the truth; not a number without sigma.
        bounds: Interval of 95 % of the coverage.
    """

    cell: int
    levels: Mapping[str, Level]
    estimator: str
    runs: int
    error: float
    coverage: float
    bounds: tuple[float, float]


def summarise(rows: Iterable[Row]) -> list[CellSummary]:
    """Summarise the rows of a campaign's table, by cell and estimator.

    Args:
        rows: Rows, as dictionaries.
    """
    done = sorted(
        (row for row in rows if row["status"] == "done"), key=itemgetter("cell")
    )
    return [
        summary
        for cell, replicates in groupby(done, key=itemgetter("cell"))
        for summary in _of_cell(cell, list(replicates))
    ]


def _of_cell(cell: int, rows: Sequence[Row]) -> Iterator[CellSummary]:
    levels = {
        name.removeprefix("factor/"): level
        for name, level in rows[0].items()
        if name.startswith("factor/")
    }
    for estimator in ESTIMATORS:
        errors = [row.get(f"metric/{estimator}_rms_relative_error") for row in rows]
        known = [error for error in errors if error is not None]
        if not known:
            continue
        inside = [_inside(row, estimator) for row in rows]
        coverage, low, high = coverage_of([each for each in inside if each])
        yield CellSummary(
            cell,
            levels,
            estimator,
            len(known),
            float(np.median(known)),
            coverage,
            (low, high),
        )


def _inside(row: Row, method: str) -> list[bool]:
    """Whether the interval of 95 % of each parameter holds the truth."""
    return [
        abs(each["value"] - each["truth"]) <= stats.norm.ppf(0.975) * each["sigma"]
        for each in row["estimates"]
        if each["method"] == method and np.isfinite(each["sigma"])
    ]


def coverage_of(runs: Sequence[Sequence[bool]]) -> tuple[float, float, float]:
    """Coverage, and its interval of 95 % by E. L. Korn and B. I. Graubard.

    That is the interval of C. J. Clopper and E. S. Pearson for an effective number of independent
    intervals: those of one run share its noise.

    Args:
        runs: Whether each interval of each run holds the truth.
    """
    if not runs:
        return np.nan, np.nan, np.nan
    shares = np.array([np.mean(run) for run in runs])
    coverage, count = float(shares.mean()), float(sum(map(len, runs)))
    if len(runs) > 1 and shares.std() > 0:
        variance = shares.var(ddof=1) / len(runs)
        count = min(count, coverage * (1 - coverage) / variance)
    inside = coverage * count
    low = stats.beta.ppf(0.025, inside, count - inside + 1)
    high = stats.beta.ppf(0.975, inside + 1, count - inside)
    return coverage, float(np.nan_to_num(low)), float(np.nan_to_num(high, nan=1.0))
