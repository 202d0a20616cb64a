"""What came of a campaign: whatever was computed is there, once, and whole.

campaign.toml     what was asked for, every default written out
results.parquet   a row a run of the campaign, in order
earlier.parquet   rows of runs that are not the campaign's any more: another version of the code,
                  levels that were taken out; they are found again where they are asked for again
new/              rows that have come since the table was written, a file a bundle
recordings/       a Parquet file a run, where they are kept
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from sys import intern
from typing import Any, get_args

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import tomli_w
from numpy.typing import NDArray

from testbed.campaigns.bundle import Outcome, Status
from testbed.campaigns.campaign import Campaign, CampaignTables, Place
from testbed.core.base.errors import ExperimentError, RecordingError, plural, printable, quoted
from testbed.core.base.files import replacing
from testbed.core.estimation.estimate import METHODS
from testbed.lab.experiment.experiment_tables import METRICS

RESULTS, EARLIER, CAMPAIGN = "results.parquet", "earlier.parquet", "campaign.toml"
NEW, RECORDINGS, LOCK = "new", "recordings", "lock"

OWN = {RESULTS, EARLIER, CAMPAIGN, NEW, RECORDINGS, LOCK}
"""Names that make a folder a campaign's."""

LEAST_NEW = 1000
"""New rows that are worth writing the table again, unless it is larger than that."""

SAID = ("code", "level", "subject", "text")
"""Of a diagnostic, that is in the table."""

FORMAT = "testbed campaign 1"
"""Name and version of the layout, kept in the file."""

KEY = b"testbed"
"""Under which the schema keeps the metadata."""

KINDS = {"struct<": "records", "string": "text"}
KINDS |= dict.fromkeys(("int", "double", "float"), "numbers")
"""Kinds of types, by a part of their names."""

AT_ONCE = 10_000
"""Rows of a group: what is held twice while a table is written."""

LONGEST_REASON = 130
"""Characters of why a table is refused."""

TEXT, NUMBER = pa.string(), pa.float64()

SURE = {
    **dict.fromkeys(("run", "status", "error", "command"), TEXT),
    **dict.fromkeys(("cell", "replicate"), pa.int32()),
    "seed": pa.int64(),
}
"""Columns that have a value in every row."""

LISTS = ("names", "truth", "values", "sigma", "relative_error")
"""Of every estimate, a list each in the order of its names."""

FOUND = {
    **{f"{m}/{k}": pa.list_(TEXT if k == LISTS[0] else NUMBER) for m in METHODS for k in LISTS},
    "diagnostics": pa.list_(pa.struct([(name, TEXT) for name in SAID])),
}
"""Columns that are empty where a run has no result; before them come factors and metrics."""


def schema_of(campaign: Campaign) -> pa.Schema:
    """The columns of a campaign's table, and what is said of it there."""
    columns = dict(SURE)
    for k, name in enumerate(campaign.factors):
        named = any(isinstance(cell.levels[k], str) for cell in campaign.cells)
        columns[f"factor/{name}"] = TEXT if named else NUMBER
    columns |= {f"metric/{name}": NUMBER for name in METRICS} | FOUND
    about = {
        "format": FORMAT,
        "name": campaign.tables.name,
        "claim": campaign.tables.claim,
        "experiment": campaign.base.name,
        "cells": len(campaign.cells),
        "methods": list(campaign.tables.methods),
        "logarithmic": [f.name for f in campaign.tables.factor if f.log],
        "columns": list(columns),
    }
    return pa.schema(columns, metadata={KEY: json.dumps(about, sort_keys=True)})


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
        RecordingError: The file is no campaign's table, damaged or edited; names the column.
    """
    with _opened(path) as (file, schema):
        wanted = [name for name in schema.names if columns is None or name in columns]
        return _checked(file.read(wanted), schema, path)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[pq.ParquetFile, pa.Schema]]:
    """Open a campaign's table with the declared schema of its columns.

    Raises:
        RecordingError: The file is no campaign's table, or is found to be wrong in the block.
    """
    try:
        with pq.ParquetFile(path) as file:
            yield file, _declared(file.schema_arrow)
    except (pa.ArrowException, OSError, ValueError, KeyError, RuntimeError) as error:
        reason = printable(str(error), LONGEST_REASON)
        raise RecordingError(
            f"{path}: not a readable table of a campaign: {reason}; put back a copy, or move the "
            "file away: the campaign's command then makes its runs again"
        ) from None


def _declared(found: pa.Schema) -> pa.Schema:
    """Declared types of the columns of a file; columns that nobody declares are left out.

    Raises:
        ValueError: Of another layout, or a column is missing or of another kind.
    """
    said, known = about(found), SURE | FOUND
    if said.get("format") != FORMAT:
        raise ValueError(f"it is not of the layout '{FORMAT}'")
    listed = said.get("columns")  # tables of older versions do not list them
    for name in [*known, *(listed if isinstance(listed, list) else ())]:
        if (times := found.names.count(name)) != 1:
            raise ValueError(f"column '{name}' is there {times} times, not once")
    columns = {}
    for field in found:
        kind, name = _kind(field.type), field.name
        if name.startswith("factor/"):
            known[name] = TEXT if kind == "text" else NUMBER
        elif name.startswith("metric/"):
            known[name] = NUMBER
        if name in known:
            columns[name] = known[name]
            if kind not in (_kind(known[name]), "null"):
                raise ValueError(f"column '{name}' holds {kind}, not {_kind(known[name])}")
    return pa.schema(columns, metadata=found.metadata)


def _kind(of: pa.DataType) -> str:
    """Name of a column type, the same for all precisions and storages."""
    said = str(of)
    content = next((kind for mark, kind in KINDS.items() if mark in said), said)
    return f"lists of {content}" if "list<" in said else content


def _checked(rows: pa.Table, schema: pa.Schema, path: Path) -> pa.Table:
    """Cast rows to the declared types and check their values.

    Raises:
        ValueError: A value is none; names the column.
    """
    columns: dict[str, pa.ChunkedArray] = {}
    for name in rows.column_names:
        try:
            values = columns[name] = rows[name].cast(schema.field(name).type)
        except pa.ArrowException as error:
            raise ValueError(f"column '{name}': {error}") from None
        level = name.startswith("factor/") and path.name != EARLIER
        if values.null_count and (level or name in SURE):
            raise ValueError(f"column '{name}' has {plural(values.null_count, 'empty value')}")
        if level and values.type == NUMBER and not pc.all(pc.is_finite(values)).as_py():
            raise ValueError(f"column '{name}' has a level that is not finite")
    if others := {*columns.get("status", pa.array([])).to_pylist()} - {*get_args(Status)}:
        raise ValueError(f"column 'status' has {quoted(others)}, not {quoted(get_args(Status))}")
    for method in METHODS:
        if f"{method}/names" in columns:
            _check_estimates(columns, method)
    return pa.table(columns, metadata=schema.metadata)


def _check_estimates(columns: Mapping[str, pa.ChunkedArray], method: str) -> None:
    """Check that the lists of each estimate have one length and possible values.

    Raises:
        ValueError: They do not; names the column.
    """
    lists = {kind: columns[f"{method}/{kind}"] for kind in LISTS}
    sizes = [pc.fill_null(pc.list_value_length(each), -1) for each in lists.values()]
    names, truth, value, sigma, _ = (pc.list_flatten(each).to_numpy() for each in lists.values())
    faults = {kind: not size.equals(sizes[0]) for kind, size in zip(LISTS, sizes, strict=True)}
    if not any(faults.values()):
        seen = np.isfinite(value)  # else no motion separates the parameter from others
        faults = {
            "names": any(name is None for name in names),
            "truth": not np.isfinite(truth).all(),
            "values": (np.isfinite(sigma) & ~seen).any(),
            "sigma": ((sigma < 0) | np.isnan(sigma) & seen).any(),
        }
    for kind, wrong in faults.items():
        if wrong:
            raise ValueError(f"'{method}/names' and '{method}/{kind}' hold what no estimate gives")


def about(schema: pa.Schema) -> dict[str, Any]:
    """What a table says of its campaign."""
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
        """The rows of these numbers, in this order; not too many at once."""
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
    with _opened(path) as (file, schema):
        sizes = np.array([file.metadata.row_group(g).num_rows for g in range(file.num_row_groups)])
        ends = np.cumsum(sizes)
        group = np.searchsorted(ends, rows, side="right")
        wanted = np.unique(group)
        before = np.cumsum([0, *sizes[wanted][:-1]])
        at = rows - (ends - sizes)[group] + before[np.searchsorted(wanted, group)]
        whole = file.read_row_groups(wanted.tolist(), columns=schema.names)
        return _checked(whole.take(pa.array(at)), schema, path)


def _fitted(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """The same rows with a schema's columns, empty where missing or now of another type."""
    columns = []
    for field in schema:
        same = field.name in table.column_names and table.schema.field(field.name).equals(field)
        columns.append(table[field.name] if same else pa.nulls(len(table), field.type))
    return pa.table(columns, schema=schema)


def texts_of(rows: pa.Table, column: str) -> list[str]:
    """A column of text, equal texts only once in memory: a large campaign knows each many times.

    Args:
        rows: The table.
        column: Its name.
    """
    return [intern(each) for part in rows[column].chunks for each in part.to_pylist()]


class CampaignFolder:
    """The rows of a campaign, on disk; written by one process alone.

    Attributes:
        path: The folder.
        places: Of all runs of the campaign, by hash.
        status: Of every run that is there, by hash.
        figures: Values of the figure that a rule for stopping looks at, by hash.
    """

    def __init__(self, path: Path, campaign: Campaign, places: Mapping[str, Place]) -> None:
        """Look what is there; everything that was left half-way is put in order.

        Args:
            path: The folder; made if it is not there.
            campaign: Whose it is.
            places: Of all runs of the campaign, by hash, in order.
        """
        self.path, self.places = path, places
        self._campaign, self._schema = campaign, schema_of(campaign)
        self.status: dict[str, str] = {}
        self.figures: dict[str, float | None] = {}
        self._waiting = self._written = self._number = 0
        if any(file.exists() for file in self._files()):
            self.compact()

    def _files(self) -> list[Path]:
        """All tables, the oldest first."""
        new = sorted((self.path / NEW).glob("*.parquet"))
        return [self.path / RESULTS, self.path / EARLIER, *new]

    def add(self, outcomes: Sequence[Outcome]) -> None:
        """Keep what came of a bundle: safe on disk when this returns."""
        for outcome in outcomes:
            if outcome.recording is not None:
                with replacing(self.path / RECORDINGS / f"{outcome.run}.parquet") as fresh:
                    fresh.write_bytes(outcome.recording)
        rows = pa.Table.from_pylist([self._row(each) for each in outcomes], schema=self._schema)
        self._number += 1
        name = f"{self._number:08d}-{outcomes[0].run}.parquet"
        write_rows(self.path / NEW / name, [rows], self._schema)
        self._note(rows)
        self._waiting += len(rows)
        if self._waiting >= max(LEAST_NEW, self._written):
            self.compact()

    def _row(self, outcome: Outcome) -> dict[str, Any]:
        row: dict[str, Any] = {
            "run": outcome.run,
            "status": outcome.status,
            "error": outcome.error,
            "diagnostics": [
                {name: getattr(each, name) for name in SAID} for each in outcome.diagnostics
            ],
        }
        row |= self._known(outcome.run, outcome.status)
        row |= {f"metric/{name}": value for name, value in (outcome.metrics or {}).items()}
        for method, estimate in (outcome.estimates or {}).items():
            row |= {f"{method}/{kind}": values for kind, values in estimate.items()}
        return row

    def _known(self, run: str, status: str) -> dict[str, Any]:
        """Columns that the campaign knows of a run by its place."""
        campaign, place = self._campaign, self.places[run]
        row: dict[str, Any] = {
            "cell": place.cell,
            "replicate": place.replicate,
            "seed": campaign.seed(*place),
            "command": "" if status == "done" else campaign.command(*place),
        }
        for name, level in zip(campaign.factors, campaign.cells[place.cell].levels, strict=True):
            named = self._schema.field(f"factor/{name}").type == pa.string()
            row[f"factor/{name}"] = str(level) if named else float(level)
        return row

    def _note(self, rows: pa.Table) -> None:
        runs = texts_of(rows, "run")
        self.status |= dict(zip(runs, texts_of(rows, "status"), strict=True))
        if self._campaign.tables.stop is not None:
            figures = rows[f"metric/{self._campaign.tables.stop.figure}"]
            values = pc.if_else(pc.is_nan(figures), None, figures).to_pylist()
            self.figures |= dict(zip(runs, values, strict=True))

    def compact(self) -> None:
        """All rows into one table, and what is not the campaign's any more into another one.

        A file is removed only when what it holds stands elsewhere.
        """
        there = [file for file in self._files() if file.exists()]
        stored, earlier = StoredRows(there, self._schema), self.path / EARLIER
        others = [row for run, row in stored.where.items() if run not in self.places]
        if others or earlier.exists():  # what comes back from there stays until it stands elsewhere
            kept = sorted({*others, *stored.of_file(earlier)})
            write_rows(earlier, stored.parts(kept), self._schema)
            there = [file for file in self._files() if file.exists()]
            stored = StoredRows(there, self._schema)
        mine = [stored.where[run] for run in self.places if run in stored.where]
        placed = (self._placed(part) for part in stored.parts(mine))
        write_rows(self.path / RESULTS, placed, self._schema)
        for file in there:
            if file.parent.name == NEW:
                file.unlink()
        if earlier.exists():
            self._leave_others(earlier)
        self._waiting, self._written = 0, len(mine)
        pa.default_memory_pool().release_unused()

    def _leave_others(self, earlier: Path) -> None:
        """Rows of the campaign stand in its own table now, and need not in that of others."""
        stored = StoredRows([earlier], self._schema)
        others = [row for run, row in stored.where.items() if run not in self.places]
        if len(others) < len(stored.of_file(earlier)):
            write_rows(earlier, stored.parts(others), self._schema)

    def _placed(self, rows: pa.Table) -> pa.Table:
        """Rows, noted, with what this campaign says of them: they may come from an earlier one."""
        columns: dict[str, list[object]] = {}
        marks = zip(texts_of(rows, "run"), texts_of(rows, "status"), strict=True)
        for run, status in marks:
            for name, value in self._known(run, status).items():
                columns.setdefault(name, []).append(value)
        for name, values in columns.items():
            index, field = self._schema.get_field_index(name), self._schema.field(name)
            rows = rows.set_column(index, field, pa.array(values, field.type))
        self._note(rows)
        return rows

    def failures(self) -> list[tuple[str, str]]:
        """Runs without a result: what makes each again, and why it has none."""
        rows = read_rows(self.path / RESULTS, ["status", "command", "error"]).to_pylist()
        return [(row["command"], row["error"]) for row in rows if row["status"] != "done"]

    def missing(self, runs: Collection[str]) -> list[str]:
        """Which of some runs have no result yet; those that were killed have none.

        Args:
            runs: By hash.
        """
        return [run for run in runs if self.status.get(run, "killed") == "killed"]


@contextmanager
def own_folder(path: Path, tables: CampaignTables) -> Iterator[None]:
    """A campaign's folder for one process alone.

    Args:
        path: The folder; made if it is not there.
        tables: What is asked for; kept in it.

    Raises:
        ExperimentError: Something else is there, or another process is writing there.
    """
    if path.exists() and not path.is_dir():
        raise ExperimentError(f"'{path}' is a file; name a folder with --out")
    present = {each.name for each in path.iterdir()} if path.is_dir() else set()
    others = sorted(name for name in present - OWN if not name.startswith("."))
    if present and CAMPAIGN not in present and others:
        raise ExperimentError(
            f"'{path}' is no campaign's folder: it holds {', '.join(others[:3])}; name another "
            "with --out"
        )
    path.mkdir(parents=True, exist_ok=True)
    lock = os.open(path / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise ExperimentError(f"another command is writing to '{path}'; wait for it") from None
    except OSError:
        pass  # a file system without locks
    try:
        with replacing(path / CAMPAIGN) as fresh:
            said = tables.model_dump(mode="json", exclude_none=True)
            fresh.write_text(tomli_w.dumps(said), encoding="utf-8")
        yield
    finally:
        os.close(lock)
