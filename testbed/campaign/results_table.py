"""The table of a campaign: one Parquet file, a row a run."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import pyarrow as pa
import pyarrow.parquet as pq

from testbed.campaign.bundle import Outcome
from testbed.errors import RecordingError
from testbed.experiment.experiment_tables import METRICS
from testbed.files import replacing
from testbed.identification.estimate import METHODS

FORMAT = "testbed campaign 1"
"""Name and version of the layout, kept in the file."""

Said: TypeAlias = Callable[["Place", str], dict[str, Any]]
"""Columns that a campaign knows of a run by its place and its status."""

KEY = b"testbed"
"""Under which the schema keeps the metadata."""

AT_ONCE = 10_000
"""Rows of a group: what is held twice while a table is written."""

NUMBERS = ("truth", "values", "sigma", "relative_error")
"""Of every estimate, a list each in the order of its names."""


class Place(NamedTuple):
    """Where a run stands in its campaign: numbers of its cell and of its replicate there."""

    cell: int
    replicate: int


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
        pa.field("seed", pa.int64()),
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
    outcomes: Iterable[Outcome], places: Mapping[str, Place], said: Said, schema: pa.Schema
) -> pa.Table:
    """Outcomes as rows.

    Args:
        outcomes: Of some runs.
        places: Of these runs, by hash.
        said: What the campaign says of a place.
        schema: Of the table.
    """
    rows = []
    for outcome in outcomes:
        row: dict[str, Any] = {
            "run": outcome.run,
            "status": outcome.status,
            "error": outcome.error,
            "warnings": list(outcome.warnings),
        }
        row |= said(places[outcome.run], outcome.status)
        row |= {f"metric/{name}": value for name, value in (outcome.metrics or {}).items()}
        for method, estimate in (outcome.estimates or {}).items():
            row |= {f"{method}/{kind}": values for kind, values in estimate.items()}
        rows.append(row)
    return pa.Table.from_pylist(rows, schema=schema)


def write_rows(path: Path, parts: Iterable[pa.Table], schema: pa.Schema) -> None:
    """Write a table; it appears whole or not at all.

    Args:
        path: The file.
        parts: Its rows, a group each.
        schema: Of the table.
    """
    with replacing(path) as fresh, pq.ParquetWriter(fresh, schema, compression="zstd") as writer:
        for part in parts:
            writer.write_table(part)


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


def joined(tables: Sequence[pa.Table], schema: pa.Schema) -> tuple[pa.Table, dict[str, int]]:
    """Rows of several tables, and which of them counts for each run.

    What has a result goes first, then what comes first.

    Args:
        tables: Of one campaign, perhaps with other columns.
        schema: Of the result.
    """
    every = pa.concat_tables([schema.empty_table(), *(_fitted(table, schema) for table in tables)])
    where: dict[str, int] = {}
    status = every["status"].to_pylist()
    for row, run in enumerate(every["run"].to_pylist()):
        if run not in where or (status[where[run]] == "killed" and status[row] != "killed"):
            where[run] = row
    return every, where


def slices(table: pa.Table, rows: Sequence[int]) -> Iterator[pa.Table]:
    """Some rows of a table, not too many at once.

    Args:
        table: The table.
        rows: Their numbers.
    """
    for first in range(0, len(rows), AT_ONCE):
        chosen = pa.array(rows[first : first + AT_ONCE], pa.int64())
        yield table.take(chosen).combine_chunks()


def _fitted(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """The same rows with a schema's columns: those that are missing are empty."""
    columns = []
    for field in schema:
        if field.name in table.column_names:
            columns.append(table[field.name].cast(field.type))
        else:
            columns.append(pa.nulls(len(table), field.type))
    return pa.table(columns, schema=schema)
