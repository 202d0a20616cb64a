"""The table of a campaign: one Parquet file, a row a run."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from testbed.campaign.bundle import Outcome
from testbed.errors import RecordingError
from testbed.experiment.experiment_tables import METRICS
from testbed.files import replacing
from testbed.identification.estimate import METHODS

FORMAT = "testbed campaign 1"
"""Name and version of the layout, kept in the file."""

KEY = b"testbed"
"""Under which the schema keeps the metadata."""

NUMBERS = ("truth", "values", "sigma", "relative_error")
"""Of every estimate, a list each in the order of its names."""


@dataclass(frozen=True)
class Place:
    """Where a run stands in its campaign.

    Attributes:
        cell: Number of its cell.
        replicate: Its number in the cell.
        levels: Of the factors.
        command: What makes it again.
    """

    cell: int
    replicate: int
    levels: tuple[float | str, ...]
    command: str


def schema_of(factors: Mapping[str, Sequence[float | str]], about: Mapping[str, Any]) -> pa.Schema:
    """The columns of a campaign's table.

    Args:
        factors: All levels by factor: numbers or names.
        about: What the file says besides, as JSON takes it.
    """
    fields = [
        pa.field("run", pa.string()),
        pa.field("status", pa.string()),
        pa.field("error", pa.string()),
        pa.field("command", pa.string()),
        pa.field("cell", pa.int32()),
        pa.field("replicate", pa.int32()),
    ]
    for name, levels in factors.items():
        named = any(isinstance(level, str) for level in levels)
        fields.append(pa.field(f"factor/{name}", pa.string() if named else pa.float64()))
    fields += [pa.field(f"metric/{name}", pa.float64()) for name in METRICS]
    for method in METHODS:
        fields.append(pa.field(f"{method}/names", pa.list_(pa.string())))
        fields += [pa.field(f"{method}/{kind}", pa.list_(pa.float64())) for kind in NUMBERS]
    fields.append(pa.field("warnings", pa.list_(pa.string())))
    text = json.dumps({"format": FORMAT, **about}, sort_keys=True)
    return pa.schema(fields, metadata={KEY: text})


def rows_of(
    outcomes: Iterable[Outcome], places: Mapping[str, Place], schema: pa.Schema
) -> pa.Table:
    """Outcomes as rows.

    Args:
        outcomes: Of some runs.
        places: Of these runs, by hash.
        schema: Of the table.
    """
    rows = []
    for outcome in outcomes:
        place = places[outcome.run]
        row: dict[str, Any] = {
            "run": outcome.run,
            "status": outcome.status,
            "error": outcome.error,
            "command": place.command,
            "cell": place.cell,
            "replicate": place.replicate,
            "warnings": list(outcome.warnings),
        }
        names = [field.name for field in schema if field.name.startswith("factor/")]
        for name, level in zip(names, place.levels, strict=True):
            row[name] = str(level) if schema.field(name).type == pa.string() else level
        row |= {f"metric/{name}": value for name, value in (outcome.metrics or {}).items()}
        for method, estimate in (outcome.estimates or {}).items():
            row |= {f"{method}/{kind}": values for kind, values in estimate.items()}
        rows.append(row)
    return pa.Table.from_pylist(rows, schema=schema)


def write_rows(path: Path, rows: pa.Table) -> None:
    """Write a table; it appears whole or not at all.

    Args:
        path: The file.
        rows: What it holds.
    """
    with replacing(path) as fresh:
        pq.write_table(rows, fresh, compression="zstd", row_group_size=10_000)


def read_rows(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a table.

    Args:
        path: The file.
        columns: Only these; those that it lacks are left out.

    Raises:
        RecordingError: It is no campaign's table, or damaged.
    """
    try:
        with pq.ParquetFile(path) as file:
            if about(file.schema_arrow).get("format") != FORMAT:
                raise ValueError(f"it is not of the layout '{FORMAT}'")
            there = file.schema_arrow.names
            wanted = None if columns is None else [name for name in columns if name in there]
            return file.read(wanted)
    except (pa.ArrowException, OSError, ValueError, KeyError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise RecordingError(f"{path}: not a readable table of a campaign: {reason}") from None


def about(schema: pa.Schema) -> dict[str, Any]:
    """What a table says of its campaign.

    Args:
        schema: Of the table.
    """
    found = json.loads((schema.metadata or {}).get(KEY, b"{}"))
    return found if isinstance(found, dict) else {}


def joined(tables: Sequence[pa.Table], schema: pa.Schema) -> pa.Table:
    """Rows of several tables, every run once: what has a result goes first, then what comes first.

    Args:
        tables: Of one campaign, perhaps with other columns.
        schema: Of the result.
    """
    fitted = [_fitted(table, schema) for table in tables]
    every = pa.concat_tables([schema.empty_table(), *fitted])
    where: dict[str, int] = {}
    status = every["status"].to_pylist()
    for row, run in enumerate(every["run"].to_pylist()):
        if run not in where or (status[where[run]] == "killed" and status[row] != "killed"):
            where[run] = row
    return every.take(pa.array(sorted(where.values()), pa.int64()))


def in_order(table: pa.Table) -> pa.Table:
    """The rows in the order of replicates, and of cells in each.

    Args:
        table: Every run once.
    """
    order = pc.sort_indices(table, [("replicate", "ascending"), ("cell", "ascending")])
    return table.take(order).combine_chunks()


def _fitted(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """The same rows with a schema's columns: those that are missing are empty."""
    columns = []
    for field in schema:
        if field.name in table.column_names:
            columns.append(table[field.name].cast(field.type))
        else:
            columns.append(pa.nulls(len(table), field.type))
    return pa.table(columns, schema=schema)
