"""Errors and coverage of a campaign, by cell and estimator."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np
from scipy import stats

from testbed.campaigns.campaign import Level
from testbed.core.parameters.rules import SIGNALS

ESTIMATORS = (*SIGNALS, "consistent")
"""Estimators with a metric of their errors."""

Row = Mapping[str, Any]
"""Row of a campaign's results table."""


@dataclass(frozen=True)
class CellSummary:
    """Errors and coverage of one estimator over the replicates of one cell.

    Attributes:
        cell: Index of the cell.
        levels: Levels of the cell, keyed by factor.
        estimator: Name of a method, or "consistent".
        runs: Number of runs with an estimate of this estimator.
        error: Median over the runs of the rms relative error.
        coverage: Fraction of the 95 % confidence intervals that contain the true value; NaN without
            standard deviations.
        bounds: 95 % confidence interval of the coverage.
    """

    cell: int
    levels: Mapping[str, Level]
    estimator: str
    runs: int
    error: float
    coverage: float
    bounds: tuple[float, float]


def summarise(rows: Iterable[Row]) -> list[CellSummary]:
    """Errors and coverage computed from the rows of a campaign's table.

    Summaries are in the order of cells, then of estimators. Failed runs are ignored; a cell without
    successful runs has no summary.

    Args:
        rows: Rows of the table, as dictionaries.
    """
    done = sorted(
        (row for row in rows if row["status"] == "done"), key=itemgetter("cell")
    )
    return [
        summary
        for cell, replicates in groupby(done, key=itemgetter("cell"))
        for summary in _cell_summaries(cell, list(replicates))
    ]


def _cell_summaries(cell: int, rows: Sequence[Row]) -> Iterator[CellSummary]:
    """Yield the summaries of a cell's estimators, in the order of `ESTIMATORS`.

    An estimator is skipped if no run of the cell has its error metric.

    Args:
        cell: Number of the cell.
        rows: Rows of the successful runs of the cell.
    """
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
        inside = [_intervals_with_truth(row, estimator) for row in rows]
        coverage, low, high = coverage_with_interval([each for each in inside if each])
        yield CellSummary(
            cell,
            levels,
            estimator,
            len(known),
            float(np.median(known)),
            coverage,
            (low, high),
        )


def _intervals_with_truth(row: Row, method: str) -> list[bool]:
    """Results of comparing each 95 % confidence interval of a run with the true value.

    An element is True if the interval contains the true value. Parameters without a finite standard
    deviation have no interval.

    Args:
        row: Row of the run.
        method: Name of the estimator.
    """
    return [
        abs(each["value"] - each["truth"]) <= stats.norm.ppf(0.975) * each["sigma"]
        for each in row["estimates"]
        if each["method"] == method and np.isfinite(each["sigma"])
    ]


def coverage_with_interval(
    runs: Sequence[Sequence[bool]],
) -> tuple[float, float, float]:
    """Coverage of confidence intervals, and its own 95 % confidence interval.

    Coverage is the mean over runs of the fraction of intervals that contain the true value. Since
    the intervals of one run share its noise, the effective number of independent intervals is
    computed from the variance between runs (E. L. Korn and B. I. Graubard). The interval of the
    coverage is that of C. J. Clopper and E. S. Pearson for this number.

    Args:
        runs: For each run, a list with True for each interval that contains the true value.

    Returns:
        Coverage, and lower and upper bound of its interval; NaN without runs.
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
