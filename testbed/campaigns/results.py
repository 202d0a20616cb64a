"""Results table of a campaign: one Parquet file, a row for each run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from testbed.campaigns.campaign import Campaign
from testbed.core.base.errors import RecordingError, printable_line
from testbed.core.base.files import atomic_output
from testbed.lab.experiment.experiment_tables import METRICS

RESULTS_FILE = "results.parquet"
"""Name of the table in a campaign's folder."""

FORMAT = "testbed campaign 2"
"""Name and version of the layout, stored in the file."""

METADATA_KEY = b"testbed"
"""Key of the campaign's name and claim in the metadata of the schema."""

MAX_REASON_LENGTH = 130
"""Largest number of characters of the reason why a table is refused."""

TEXT, NUMBER, INTEGER = pa.string(), pa.float64(), pa.int64()
"""Arrow types of columns."""

PARAMETER_NUMBERS = ("truth", "value", "sigma", "relative_error")
"""Numbers stored for a parameter of an estimate."""

PARAMETER = pa.struct(
    dict.fromkeys(("method", "parameter"), TEXT)
    | dict.fromkeys(PARAMETER_NUMBERS, NUMBER)
)
"""Arrow type of a parameter of an estimate."""

COLUMNS = {
    **dict.fromkeys(("run", "status", "error", "command"), TEXT),
    **dict.fromkeys(("cell", "replicate", "seed"), INTEGER),
    "estimates": pa.list_(PARAMETER),
    "diagnostics": pa.list_(TEXT),
}
"""Columns of every table; columns of factors and metrics are added."""

NULLABLE_COLUMNS = ("estimates", "diagnostics")
"""Columns that are empty for a failed run."""


def write_rows(
    path: Path, campaign: Campaign, rows: Sequence[Mapping[str, Any]]
) -> None:
    """Write the results table of a campaign in one atomic step.

    Args:
        path: The file.
        campaign: The campaign of the runs.
        rows: One row per run, keyed by the names in `COLUMNS`, "factor/NAME" and "metric/NAME";
            missing values are null.
    """
    columns = dict(COLUMNS)
    for k, name in enumerate(campaign.factors):
        has_names = any(isinstance(cell.levels[k], str) for cell in campaign.cells)
        columns[f"factor/{name}"] = TEXT if has_names else NUMBER
    columns |= {f"metric/{name}": NUMBER for name in METRICS}
    tables = campaign.tables
    description = {"format": FORMAT, "name": tables.name, "claim": tables.claim}
    schema = pa.schema(columns, metadata={METADATA_KEY: json.dumps(description)})
    with atomic_output(path) as temporary_path:
        pq.write_table(
            pa.Table.from_pylist(rows, schema), temporary_path, compression="zstd"
        )


@dataclass(frozen=True)
class Results:
    """Content of a campaign's results table.

    Attributes:
        name: Name of the campaign.
        claim: Claim of the campaign, in a sentence.
        rows: Rows of the runs, as dictionaries keyed by column.
    """

    name: str
    claim: str
    rows: list[dict[str, Any]]

    @property
    def failures(self) -> list[dict[str, Any]]:
        """Rows of the failed runs."""
        return [row for row in self.rows if row["status"] != "done"]


def read_campaign_results(path: Path) -> Results:
    """Read the results table of a campaign, and check its schema.

    Columns other than `COLUMNS`, factors and metrics are ignored.

    Args:
        path: The file.

    Raises:
        RecordingError: The file is not the table of a campaign, or is damaged.
    """
    try:
        table = pq.ParquetFile(path).read()
        description = json.loads(table.schema.metadata[METADATA_KEY])
        if description["format"] != FORMAT:
            raise ValueError(f"it is not of the layout '{FORMAT}'")
        fields = [
            pa.field(name, kind, name in NULLABLE_COLUMNS)
            for name, kind in COLUMNS.items()
        ]
        for field in table.schema:
            if field.name.startswith("factor/"):
                fields.append(field)
            elif field.name.startswith("metric/"):
                fields.append(pa.field(field.name, NUMBER))
        known_columns = table.select([field.name for field in fields]).cast(
            pa.schema(fields)
        )
        return Results(
            description["name"], description["claim"], known_columns.to_pylist()
        )
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        reason = printable_line(str(error), MAX_REASON_LENGTH)
        raise RecordingError(
            f"{path}: not a readable table of a campaign: {reason}; put back a copy, or move the "
            "file away: the campaign's command then makes its runs again"
        ) from None
