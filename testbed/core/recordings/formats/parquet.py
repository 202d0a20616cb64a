"""Recordings in Parquet: columns of doubles, units in the schema, metadata as JSON beside it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, no_file
from testbed.core.base.file_kinds import expecting

FORMAT = "testbed recording 1"
"""Name and version of the layout, kept in the file."""

KEY = "testbed"
"""Under which the schema keeps the metadata."""

BUFFER = 1 << 20
"""Bytes of a column that are read at once."""

MOST_METADATA = 16_000_000
"""Bytes of metadata that a recording may have."""


def is_parquet(path: Path) -> bool:
    """Whether the file begins as Parquet files do."""
    with path.open("rb") as stream:
        return stream.read(4) == b"PAR1"


def open_table(path: Path) -> ParquetTable:
    """The columns of a recording's file.

    Raises:
        RecordingError: The file is missing or damaged, or no Parquet file.
    """
    with expecting(path, "recording"):
        if not path.exists():
            raise RecordingError(no_file(path, "recording"))
        if not path.is_file():
            raise RecordingError(
                f"'{path}' is no file; testbed new --recording makes one of a dataset"
            )
        if path.suffix.lower() not in ("", ".parquet") and not is_parquet(path):
            raise RecordingError(
                f"'{path}' is no recording, which is Parquet; another program's file becomes one: "
                f"testbed new --recording {path}"
            )
        return ParquetTable(path)


class ParquetTable:
    """Columns that stay in their file; rows are read as they are asked for.

    Attributes:
        columns: Names of all columns.
        samples: Number of rows.
        metadata: What the file says besides, unchecked.
    """

    def __init__(self, path: Path) -> None:
        """Open a file; reads its end only.

        Raises:
            RecordingError: The file is damaged, or of another layout.
        """
        self._path = path
        with readable(path):
            self._file = pq.ParquetFile(path, pre_buffer=False, buffer_size=BUFFER)
            self._schema = self._file.schema_arrow
            self.columns: tuple[str, ...] = tuple(self._schema.names)
            self.samples: int = self._file.metadata.num_rows
            self.metadata = _metadata(self._schema)
        twice = {name for name in self.columns if self.columns.count(name) > 1}
        if twice:
            raise RecordingError(f"{path}: channel '{min(twice)}' is there twice")
        self._reading: tuple[str, ...] = ()
        self._restart((), 0)

    def read(self, columns: Sequence[str], first: int, last: int) -> dict[str, Array]:
        """Rows `first` to `last` - 1 of some columns; cheap where asked for in their order.

        Raises:
            RecordingError: The file is damaged there, or a column holds no numbers.
        """
        with readable(self._path):
            for name in columns:
                _check_type(self._schema.field(name))
            if tuple(columns) != self._reading or first < self._first:
                self._restart(tuple(columns), first)
            while self._first + sum(len(batch) for batch in self._batches) < last:
                self._batches.append(next(self._rest))
                while self._batches and self._first + len(self._batches[0]) <= first:
                    self._first += len(self._batches.pop(0))
            schema = pa.schema([self._schema.field(name) for name in columns])
            table = pa.Table.from_batches(self._batches, schema)
            rows = table.slice(first - self._first, last - first)
            return {name: rows[name].to_numpy().astype(np.float64) for name in columns}

    def _restart(self, columns: tuple[str, ...], first: int) -> None:
        """Read on from the row group that holds a row."""
        groups, start, group = self._file.metadata, 0, 0
        while (
            group + 1 < groups.num_row_groups
            and first >= start + groups.row_group(group).num_rows
        ):
            start += groups.row_group(group).num_rows
            group += 1
        wanted = range(group, groups.num_row_groups)
        self._first, self._reading = start, columns
        self._batches: list[pa.RecordBatch] = []
        # samples read at once
        self._rest = self._file.iter_batches(65_536, wanted, columns=list(columns))


def write_table(
    path: Path,
    units: Mapping[str, str],
    metadata: Mapping[str, Any],
    parts: Iterable[Mapping[str, Array]],
) -> None:
    """Write columns, part after part.

    Args:
        path: The file.
        units: Of every column, by name; gives the order.
        metadata: As JSON takes it.
        parts: Consecutive rows, by column.
    """
    text = json.dumps({"format": FORMAT, **metadata}, sort_keys=True)
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": u}) for name, u in units.items()
    ]
    schema = pa.schema(fields, metadata={KEY: text})
    options = {"compression": "zstd", "compression_level": 1}
    with pq.ParquetWriter(
        path, schema, use_dictionary=False, use_byte_stream_split=True, **options
    ) as writer:
        for part in parts:
            arrays = [pa.array(part[name]) for name in units]
            # samples a row group: what a streaming reader holds at once
            writer.write_table(pa.table(arrays, schema=schema), 250_000)


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Whatever pyarrow finds wrong with a file, as one error.

    Raises:
        RecordingError: Says what.
    """
    try:
        yield
    except RecordingError:
        raise
    except (
        pa.ArrowException,
        OSError,
        ValueError,
        TypeError,
        KeyError,
        StopIteration,
        RuntimeError,
        OverflowError,
        RecursionError,
    ) as error:
        reason = " ".join(str(error).split()) or "it ends early"
        raise RecordingError(
            f"{path}: not a readable Parquet recording: {reason}"
        ) from None


def _metadata(schema: pa.Schema) -> dict[str, Any]:
    """The file's own metadata, of the layout that this version knows.

    Raises:
        ValueError: They are of another layout, or too long.
    """
    text = (schema.metadata or {}).get(KEY.encode(), b"{}")
    if len(text) > MOST_METADATA:
        raise ValueError(
            f"its metadata have {len(text):.2g} bytes, more than {MOST_METADATA:.0g}"
        )
    found = json.loads(text)
    if not isinstance(found, dict) or found.get("format", FORMAT) != FORMAT:
        raise ValueError(f"its metadata are not of the layout '{FORMAT}'")
    return found


def _check_type(field: pa.Field) -> None:
    """Whether a column holds numbers.

    Raises:
        ValueError: It holds something else.
    """
    if not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type)):
        raise ValueError(
            f"channel '{field.name}' holds {field.type}, not numbers; write it as doubles"
        )
