"""The table of a campaign: one Parquet file, a row a run."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from sys import intern
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

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


class StoredRows:
    """Rows of several tables of one campaign, which stay in their files until they are asked for.

    Attributes:
        where: Number of the row that counts for each run: what has a result goes first, then what
            comes first.
    """

    def __init__(self, files: Sequence[Path], schema: pa.Schema) -> None:
        """Look which runs are there.

        Args:
            files: The tables, perhaps with other columns.
            schema: Of what is read.

        Raises:
            RecordingError: One is no campaign's table, or damaged.
        """
        self._files, self._schema = tuple(files), schema
        self.where: dict[str, int] = {}
        starts: list[int] = [0]
        killed: set[str] = set()
        for file in files:
            there = read_rows(file, ["run", "status"])
            marks = zip(texts_of(there, "run"), texts_of(there, "status"), strict=True)
            for row, (run, status) in enumerate(marks, start=starts[-1]):
                if run not in self.where or (run in killed and status != "killed"):
                    self.where[run] = row
                    (killed.add if status == "killed" else killed.discard)(run)
            starts.append(starts[-1] + len(there))
        self._starts = np.array(starts)

    def of_file(self, file: Path) -> range:
        """Numbers of the rows of a file."""
        if file not in self._files:
            return range(0)
        k = self._files.index(file)
        return range(int(self._starts[k]), int(self._starts[k + 1]))

    def parts(self, rows: Sequence[int]) -> Iterator[pa.Table]:
        """Some rows in their order, not too many at once.

        Args:
            rows: Their numbers.
        """
        for first in range(0, len(rows), AT_ONCE):
            yield self._taken(np.array(rows[first : first + AT_ONCE]))

    def _taken(self, rows: NDArray[np.int64]) -> pa.Table:
        files = np.searchsorted(self._starts, rows, side="right") - 1
        order = np.argsort(files, kind="stable")
        tables = []
        for k in np.unique(files):
            own = rows[files == k] - self._starts[k]
            tables.append(_fitted(_rows_at(self._files[k], own), self._schema))
        every = pa.concat_tables(tables)
        return every.take(pa.array(np.argsort(order))).combine_chunks()


def _rows_at(path: Path, rows: NDArray[np.int64]) -> pa.Table:
    """Some rows of a file; only the groups that hold them are read."""
    with pq.ParquetFile(path) as file:
        sizes = np.array([file.metadata.row_group(g).num_rows for g in range(file.num_row_groups)])
        ends = np.cumsum(sizes)
        group = np.searchsorted(ends, rows, side="right")
        wanted = np.unique(group)
        before = np.cumsum([0, *sizes[wanted][:-1]])
        at = rows - (ends - sizes)[group] + before[np.searchsorted(wanted, group)]
        return file.read_row_groups(wanted.tolist()).take(pa.array(at))


def _fitted(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """The same rows with a schema's columns: those that are missing are empty."""
    columns = []
    for field in schema:
        if field.name in table.column_names:
            columns.append(table[field.name].cast(field.type))
        else:
            columns.append(pa.nulls(len(table), field.type))
    return pa.table(columns, schema=schema)


def texts_of(rows: pa.Table, column: str) -> list[str]:
    """A column of text, equal texts only once in memory: a large campaign knows each many times.

    Args:
        rows: The table.
        column: Its name.
    """
    return [intern(each) for part in rows[column].chunks for each in part.to_pylist()]
