"""The table of a campaign, one Parquet file: a row a run, written as a whole, checked when read."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from testbed.campaigns.campaign import Campaign
from testbed.core.base.errors import RecordingError, printable
from testbed.core.base.files import replacing
from testbed.lab.experiment.experiment_tables import METRICS

RESULTS = "results.parquet"
"""Name of the table in a campaign's folder."""

FORMAT = "testbed campaign 2"
"""Name and version of the layout, kept in the file."""

KEY = b"testbed"
"""Key of the campaign's name and claim in the metadata of the schema."""

MAX_REASON = 130
"""Characters of why a table is refused."""

TEXT, NUMBER, INTEGER = pa.string(), pa.float64(), pa.int64()

PARAMETER_NUMBERS = ("truth", "value", "sigma", "relative_error")
"""Of one parameter of an estimate."""

PARAMETER = pa.struct(
    dict.fromkeys(("method", "parameter"), TEXT)
    | dict.fromkeys(PARAMETER_NUMBERS, NUMBER)
)
"""One parameter of an estimate."""

COLUMNS = {
    **dict.fromkeys(("run", "status", "error", "command"), TEXT),
    **dict.fromkeys(("cell", "replicate", "seed"), INTEGER),
    "estimates": pa.list_(PARAMETER),
    "diagnostics": pa.list_(TEXT),
}
"""Columns of every table; those of factors and metrics are its campaign's."""

NULLABLE = ("estimates", "diagnostics")
"""Columns that are empty where a run failed."""


def write_rows(
    path: Path, campaign: Campaign, rows: Sequence[Mapping[str, Any]]
) -> None:
    """Write a table; it appears whole or not at all.

    Args:
        path: The file.
        campaign: Whose runs they are.
        rows: A row a run.
    """
    columns = dict(COLUMNS)
    for k, name in enumerate(campaign.factors):
        named = any(isinstance(cell.levels[k], str) for cell in campaign.cells)
        columns[f"factor/{name}"] = TEXT if named else NUMBER
    columns |= {f"metric/{name}": NUMBER for name in METRICS}
    tables = campaign.tables
    about = {"format": FORMAT, "name": tables.name, "claim": tables.claim}
    schema = pa.schema(columns, metadata={KEY: json.dumps(about)})
    with replacing(path) as fresh:
        pq.write_table(pa.Table.from_pylist(rows, schema), fresh, compression="zstd")


@dataclass(frozen=True)
class Results:
    """Content of a campaign's table.

    Attributes:
        name: Name of the campaign.
        claim: What it shows.
        rows: Rows of its runs, by column.
    """

    name: str
    claim: str
    rows: list[dict[str, Any]]

    @property
    def failures(self) -> list[dict[str, Any]]:
        """Rows of the runs that failed."""
        return [row for row in self.rows if row["status"] != "done"]


def read_results(path: Path) -> Results:
    """Read a table.

    Args:
        path: The file.

    Raises:
        RecordingError: The file is no campaign's table, or damaged.
    """
    try:
        table = pq.ParquetFile(path).read()
        about = json.loads(table.schema.metadata[KEY])
        if about["format"] != FORMAT:
            raise ValueError(f"it is not of the layout '{FORMAT}'")
        fields = [
            pa.field(name, kind, name in NULLABLE) for name, kind in COLUMNS.items()
        ]
        for field in table.schema:
            if field.name.startswith("factor/"):
                fields.append(field)
            elif field.name.startswith("metric/"):
                fields.append(pa.field(field.name, NUMBER))
        named = table.select([field.name for field in fields]).cast(pa.schema(fields))
        return Results(about["name"], about["claim"], named.to_pylist())
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        reason = printable(str(error), MAX_REASON)
        raise RecordingError(
            f"{path}: not a readable table of a campaign: {reason}; put back a copy, or move the "
            "file away: the campaign's command then makes its runs again"
        ) from None
