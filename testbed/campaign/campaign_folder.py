"""A campaign's folder: whatever was computed is there, once, and whole.

campaign.toml     what was asked for, every default written out
results.parquet   a row a run of the campaign, in order
earlier.parquet   rows of runs that are not the campaign's any more: another version of the code,
                  levels that were taken out; they are found again where they are asked for again
new/              rows that have come since the table was written, a file a bundle
recordings/       a Parquet file a run, where they are kept
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import tomli_w

from testbed.campaign.bundle import Outcome
from testbed.campaign.campaign import CampaignTables
from testbed.campaign.results_table import (
    Place,
    Said,
    StoredRows,
    read_rows,
    rows_of,
    texts_of,
    write_rows,
)
from testbed.errors import ExperimentError
from testbed.files import replacing

RESULTS, EARLIER, CAMPAIGN = "results.parquet", "earlier.parquet", "campaign.toml"
NEW, RECORDINGS, LOCK = "new", "recordings", "lock"

OWN = {RESULTS, EARLIER, CAMPAIGN, NEW, RECORDINGS, LOCK}
"""Names that make a folder a campaign's."""

LEAST_NEW = 1000
"""New rows that are worth writing the table again, unless it is larger than that."""


class CampaignFolder:
    """The rows of a campaign, on disk; written by one process alone.

    Attributes:
        path: The folder.
        places: Of all runs of the campaign, by hash.
        status: Of every run that is there, by hash.
        figures: Values of the figure that a rule for stopping looks at, by hash.
    """

    def __init__(
        self,
        path: Path,
        schema: pa.Schema,
        runs: Mapping[str, Place],
        said: Said,
        figure: str | None = None,
    ) -> None:
        """Look what is there; everything that was left half-way is put in order.

        Args:
            path: The folder; made if it is not there.
            schema: Of the table.
            runs: Places of all runs of the campaign, by hash, in order.
            said: What the campaign says of a place.
            figure: Column that a rule for stopping looks at.
        """
        self.path, self.places = path, runs
        self._schema, self._said, self._figure = schema, said, figure
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
        """Keep what came of a bundle: safe on disk when this returns.

        Args:
            outcomes: Of its runs.
        """
        for outcome in outcomes:
            if outcome.recording is not None:
                with replacing(self.path / RECORDINGS / f"{outcome.run}.parquet") as fresh:
                    fresh.write_bytes(outcome.recording)
        rows = rows_of(outcomes, self.places, self._said, self._schema)
        self._number += 1
        name = f"{self._number:08d}-{outcomes[0].run}.parquet"
        write_rows(self.path / NEW / name, [rows], self._schema)
        self._note(rows)
        self._waiting += len(rows)
        if self._waiting >= max(LEAST_NEW, self._written):
            self.compact()

    def _note(self, rows: pa.Table) -> None:
        runs = texts_of(rows, "run")
        self.status |= dict(zip(runs, texts_of(rows, "status"), strict=True))
        if self._figure is not None:
            self.figures |= dict(zip(runs, rows[self._figure].to_pylist(), strict=True))

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
            for name, value in self._said(self.places[run], status).items():
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
