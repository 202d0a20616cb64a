"""Parquet files of recordings: float64 columns, with units and JSON metadata in the schema."""

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
from testbed.core.base.errors import RecordingError, missing_file_message
from testbed.core.base.file_kinds import explain_wrong_kind

FORMAT = "testbed recording 1"
"""Name and version of the file layout, stored in the metadata."""

METADATA_KEY = "testbed"
"""Key of the metadata in the schema."""

MAX_METADATA_BYTES = 16_000_000
"""Largest size of a recording's metadata in bytes."""


def is_parquet(path: Path) -> bool:
    """True if the file begins with the signature of Parquet files."""
    with path.open("rb") as stream:
        return stream.read(4) == b"PAR1"


def open_table(path: Path) -> ParquetTable:
    """Open the Parquet file of a recording.

    Raises:
        RecordingError: The file is missing, damaged, or not a Parquet file.
    """
    with explain_wrong_kind(path, "recording"):
        if not path.exists():
            raise RecordingError(missing_file_message(path, "recording"))
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
    """Columns of a Parquet file, with rows read on demand.

    Attributes:
        columns: Names of all columns.
        samples: Number of rows.
        metadata: Metadata of the file; only their layout is checked.
    """

    def __init__(self, path: Path) -> None:
        """Open a file; read its footer only.

        Raises:
            RecordingError: The file is damaged, or has another layout.
        """
        self._path = path
        with _parquet_errors(path):
            # one mebibyte of a column is read at a time
            self._file = pq.ParquetFile(path, pre_buffer=False, buffer_size=1 << 20)
            self._schema = self._file.schema_arrow
            self.columns: tuple[str, ...] = tuple(self._schema.names)
            self.samples: int = self._file.metadata.num_rows
            self.metadata = _metadata(self._schema)
        duplicates = {name for name in self.columns if self.columns.count(name) > 1}
        if duplicates:
            raise RecordingError(f"{path}: channel '{min(duplicates)}' is there twice")
        self._read_columns: tuple[str, ...] = ()
        self._restart((), 0)

    def read(self, columns: Sequence[str], first: int, last: int) -> dict[str, Array]:
        """Read rows `first` to `last - 1` of some columns; fastest for consecutive rows.

        Raises:
            RecordingError: These rows of the file are damaged, or a column is not numeric.
        """
        with _parquet_errors(self._path):
            for name in columns:
                _check_type(self._schema.field(name))
            if tuple(columns) != self._read_columns or first < self._first:
                self._restart(tuple(columns), first)
            while self._first + sum(len(batch) for batch in self._batches) < last:
                self._batches.append(next(self._batch_iterator))
                while self._batches and self._first + len(self._batches[0]) <= first:
                    self._first += len(self._batches.pop(0))
            schema = pa.schema([self._schema.field(name) for name in columns])
            table = pa.Table.from_batches(self._batches, schema)
            rows = table.slice(first - self._first, last - first)
            return {name: rows[name].to_numpy().astype(np.float64) for name in columns}

    def _restart(self, columns: tuple[str, ...], first: int) -> None:
        """Restart reading at the row group that contains row `first`."""
        groups, start, group = self._file.metadata, 0, 0
        while (
            group + 1 < groups.num_row_groups
            and first >= start + groups.row_group(group).num_rows
        ):
            start += groups.row_group(group).num_rows
            group += 1
        remaining_groups = range(group, groups.num_row_groups)
        self._first, self._read_columns = start, columns
        self._batches: list[pa.RecordBatch] = []
        # number of samples read at a time
        self._batch_iterator = self._file.iter_batches(
            65_536, remaining_groups, columns=list(columns)
        )


def write_table(
    path: Path,
    units: Mapping[str, str],
    metadata: Mapping[str, Any],
    parts: Iterable[Mapping[str, Array]],
) -> None:
    """Write a Parquet file of a recording, part by part.

    Args:
        path: Path of the file.
        units: Unit of each column, keyed by column name, in the order of the columns.
        metadata: Metadata as values that can be written as JSON.
        parts: Consecutive blocks of rows, each keyed by column name.
    """
    text = json.dumps({"format": FORMAT, **metadata}, sort_keys=True)
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": u}) for name, u in units.items()
    ]
    schema = pa.schema(fields, metadata={METADATA_KEY: text})
    options = {"compression": "zstd", "compression_level": 1}
    with pq.ParquetWriter(
        path, schema, use_dictionary=False, use_byte_stream_split=True, **options
    ) as writer:
        for part in parts:
            arrays = [pa.array(part[name]) for name in units]
            # number of samples in a row group, which a streaming reader holds in memory
            writer.write_table(pa.table(arrays, schema=schema), 250_000)


@contextmanager
def _parquet_errors(path: Path) -> Iterator[None]:
    """Context manager that converts errors of pyarrow into `RecordingError`.

    Raises:
        RecordingError: The file cannot be read; the message gives the reason.
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
    """Parse the JSON metadata of a schema, and check the layout.

    Raises:
        ValueError: The metadata have another layout, or are too long.
    """
    text = (schema.metadata or {}).get(METADATA_KEY.encode(), b"{}")
    if len(text) > MAX_METADATA_BYTES:
        raise ValueError(
            f"its metadata have {len(text):.2g} bytes, more than {MAX_METADATA_BYTES:.0g}"
        )
    content = json.loads(text)
    if not isinstance(content, dict) or content.get("format", FORMAT) != FORMAT:
        raise ValueError(f"its metadata are not of the layout '{FORMAT}'")
    return content


def _check_type(field: pa.Field) -> None:
    """Check that a column is numeric.

    Raises:
        ValueError: The column is of another type.
    """
    if not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type)):
        raise ValueError(
            f"channel '{field.name}' holds {field.type}, not numbers; write it as doubles"
        )
