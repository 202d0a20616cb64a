"""What a campaign's table says: errors by parameter and cell, calibration of sigma, all figures.

Bias      mean error over the replicates of a cell, as everything here over their number
Coverage  share of intervals of 95 % that hold the truth, with the bounds of C. J. Clopper and
          E. S. Pearson on the share that the binomial law allows, 95 % too
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from testbed.campaigns.results import NEW, RESULTS, StoredRows, about, read_rows
from testbed.core.base.arrays import Array
from testbed.core.base.errors import ExperimentError, formula_free
from testbed.core.base.files import replacing
from testbed.core.estimation.estimate import METHODS

NORMAL = 1.959963984540054
"""Sigmas to either side of an interval of 95 %."""

LEVEL = 0.95

Cells = dict[int, tuple[Any, ...]]
"""Levels of the factors by number of the cell."""


@dataclass(frozen=True)
class ParameterErrors:
    """One parameter by one method in one cell.

    Attributes:
        cell: Its number.
        method: The method.
        parameter: Its name.
        runs: With an estimate of it.
        truth: Mean of its true values.
        bias: Mean error.
        bias_error: Standard error of that.
        spread: Standard deviation of the errors; not a number for a single run.
        rms: Root of the mean square of the errors.
        sigma: Root of the mean square of the predicted sigmas.
        inside: Runs whose interval of 95 % holds the truth.
        relative_rms: Rms of the relative errors, as docs/experiments.md takes them; not a number
            where there is no scale.
    """

    cell: int
    method: str
    parameter: str
    runs: int
    truth: float
    bias: float
    bias_error: float
    spread: float
    rms: float
    sigma: float
    inside: int
    relative_rms: float

    @property
    def coverage(self) -> float:
        """Share of intervals that hold the truth."""
        return self.inside / self.runs

    @property
    def bounds(self) -> tuple[float, float]:
        """Of the coverage."""
        return binomial_bounds(self.inside, self.runs)


@dataclass(frozen=True)
class Figure:
    """A metric over the replicates of a cell.

    Attributes:
        cell: Its number.
        metric: Its name.
        runs: That have it.
        mean: Of them.
        error: Standard error of the mean; not a number for a single run.
    """

    cell: int
    metric: str
    runs: int
    mean: float
    error: float


@dataclass(frozen=True, eq=False)
class Summary:
    """What a campaign says.

    Attributes:
        about: Name, claim and what else its table says of it.
        factors: Names of what was varied.
        cells: Levels by number of the cell.
        runs: Rows of the table.
        failures: Command and error of runs without a result.
        parameters: Errors by cell, method and parameter.
        figures: Metrics by cell.
        z: Errors over sigmas of all runs, by method.
    """

    about: Mapping[str, Any]
    factors: tuple[str, ...]
    cells: Cells
    runs: int
    failures: tuple[tuple[str, str], ...]
    parameters: tuple[ParameterErrors, ...]
    figures: tuple[Figure, ...]
    z: Mapping[str, Mapping[str, Array]]


def read_campaign(folder: Path) -> pa.Table:
    """The rows of a campaign's folder, also of one that is still under way.

    Args:
        folder: The folder, or its table.

    Raises:
        ExperimentError: There is no table.
    """
    place = folder if folder.is_dir() else folder.parent
    files = [place / RESULTS, *sorted((place / NEW).glob("*.parquet"))]
    there = [file for file in files if file.is_file()]
    if not there:
        raise ExperimentError(f"'{folder}' is no campaign's folder: it has no {RESULTS}")
    schema = read_rows(there[0]).schema
    stored = StoredRows(there, schema)
    parts = list(stored.parts(list(stored.where.values())))
    return pa.concat_tables([schema.empty_table(), *parts])


def summarise(rows: pa.Table) -> Summary:
    """Errors, coverage and figures of a campaign."""
    names = [name for name in rows.column_names if name.startswith("factor/")]
    every = rows.to_pylist()
    done = [row for row in every if row["status"] == "done"]
    cells = {row["cell"]: tuple(row[name] for name in names) for row in every}
    return Summary(
        about=about(rows.schema),
        factors=tuple(name.removeprefix("factor/") for name in names),
        cells=dict(sorted(cells.items())),
        runs=len(every),
        failures=tuple((r["command"], r["error"]) for r in every if r["status"] != "done"),
        parameters=tuple(_parameters(done)),
        figures=tuple(_figures(done)),
        z={method: _scores(done, method) for method in METHODS},
    )


def _by_cell(rows: Sequence[Mapping[str, Any]]) -> dict[int, list[Mapping[str, Any]]]:
    found: dict[int, list[Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(row["cell"], []).append(row)
    return dict(sorted(found.items()))


def _parameters(rows: Sequence[Mapping[str, Any]]) -> Iterator[ParameterErrors]:
    for cell, here in _by_cell(rows).items():
        for method in METHODS:
            values: dict[str, list[tuple[float, ...]]] = {}
            for row in here:
                for name, *numbers in _numbers(row, method):
                    values.setdefault(name, []).append(tuple(numbers))
            for name, numbers in values.items():
                yield _errors(cell, method, name, np.array(numbers, dtype=float))


def _numbers(row: Mapping[str, Any], method: str) -> Iterator[tuple[Any, ...]]:
    """Name, truth, value, sigma and relative error of every parameter that was identifiable."""
    if row[f"{method}/names"] is None:
        return iter(())
    kinds = ("names", "truth", "values", "sigma", "relative_error")
    every = zip(*(row[f"{method}/{kind}"] for kind in kinds), strict=True)
    return (numbers for numbers in every if math.isfinite(numbers[3]))


def _errors(cell: int, method: str, name: str, numbers: Array) -> ParameterErrors:
    truth, value, sigma, relative = numbers.T
    error, count = value - truth, len(truth)
    spread = float(np.std(error, ddof=1)) if count > 1 else math.nan
    there = relative[np.isfinite(relative)]
    return ParameterErrors(
        cell=cell,
        method=method,
        parameter=name,
        runs=count,
        truth=float(truth.mean()),
        bias=float(error.mean()),
        bias_error=spread / math.sqrt(count),
        spread=spread,
        rms=_rms(error),
        sigma=_rms(sigma),
        inside=int((np.abs(error) <= NORMAL * sigma).sum()),
        relative_rms=_rms(there) if there.size else math.nan,
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _figures(rows: Sequence[Mapping[str, Any]]) -> Iterator[Figure]:
    for cell, here in _by_cell(rows).items():
        for key in here[0]:
            if not key.startswith("metric/"):
                continue
            values = np.array([row[key] for row in here], dtype=float)
            values = values[~np.isnan(values)]
            if values.size:
                spread = float(np.std(values, ddof=1)) if values.size > 1 else math.nan
                error = spread / math.sqrt(values.size)
                name = key.removeprefix("metric/")
                yield Figure(cell, name, values.size, float(values.mean()), error)


def _scores(rows: Sequence[Mapping[str, Any]], method: str) -> dict[str, Array]:
    found: dict[str, list[float]] = {}
    for row in rows:
        for name, truth, value, sigma, _ in _numbers(row, method):
            if sigma > 0:
                found.setdefault(name, []).append((value - truth) / sigma)
    return {name: np.array(values) for name, values in found.items()}


def binomial_bounds(inside: int, runs: int) -> tuple[float, float]:
    """The shares that an observed one does not contradict, by Clopper and Pearson.

    Args:
        inside: Runs that hold.
        runs: Of so many.
    """
    from scipy.stats import beta

    rest = (1 - LEVEL) / 2
    low = float(beta.ppf(rest, inside, runs - inside + 1)) if inside else 0.0
    high = float(beta.ppf(1 - rest, inside + 1, runs - inside)) if inside < runs else 1.0
    return low, high


def pooled(parts: Sequence[ParameterErrors]) -> list[ParameterErrors]:
    """Errors by method and parameter, all cells together."""
    groups: dict[tuple[str, str], list[ParameterErrors]] = {}
    for part in parts:
        groups.setdefault((part.method, part.parameter), []).append(part)
    return [_pooled(*key, group) for key, group in groups.items()]


def _pooled(method: str, name: str, parts: Sequence[ParameterErrors]) -> ParameterErrors:
    runs = sum(part.runs for part in parts)

    def mean(numbers: Sequence[float]) -> float:
        weighed = zip(numbers, parts, strict=True)
        return sum(number * part.runs for number, part in weighed) / runs

    bias, square = mean([p.bias for p in parts]), mean([p.rms**2 for p in parts])
    spread = math.sqrt(max(square - bias**2, 0) * runs / (runs - 1)) if runs > 1 else math.nan
    return ParameterErrors(
        cell=-1,
        method=method,
        parameter=name,
        runs=runs,
        truth=mean([p.truth for p in parts]),
        bias=bias,
        bias_error=spread / math.sqrt(runs),
        spread=spread,
        rms=math.sqrt(square),
        sigma=math.sqrt(mean([p.sigma**2 for p in parts])),
        inside=sum(p.inside for p in parts),
        relative_rms=math.sqrt(mean([p.relative_rms**2 for p in parts])),
    )


def write_summary(summary: Summary, folder: Path) -> list[Path]:
    """Write what a summary says, as Parquet and as CSV.

    Args:
        summary: The summary.
        folder: Where to.

    Returns:
        The files: parameters and figures, each twice.
    """

    def levels(cell: int) -> dict[str, Any]:
        columns = (f"factor/{name}" for name in summary.factors)
        return dict(zip(columns, summary.cells[cell], strict=True))

    parameters = []
    for each in summary.parameters:
        low, high = each.bounds
        more = {"coverage": each.coverage, "coverage_low": low, "coverage_high": high}
        parameters.append(levels(each.cell) | asdict(each) | more)
    figures = [levels(each.cell) | asdict(each) for each in summary.figures]
    parts = {"parameters": parameters, "figures": figures}
    written = []
    for name, rows in parts.items():
        table = pa.Table.from_pylist(rows) if rows else pa.table({})
        for ending in ("parquet", "csv"):
            path = folder / f"{name}.{ending}"
            with replacing(path) as fresh:
                if ending == "csv":
                    pc.write_csv(_formula_free(table), fresh)
                else:
                    pq.write_table(table, fresh)
            written.append(path)
    return written


def _formula_free(table: pa.Table) -> pa.Table:
    """A table whose texts no spreadsheet takes for formulas."""
    for k, field in enumerate(table.schema):
        if pa.types.is_string(field.type):
            texts = [text and formula_free(text) for text in table.column(k).to_pylist()]
            table = table.set_column(k, field, pa.array(texts, pa.string()))
    return table


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
