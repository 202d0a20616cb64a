"""Parquet files of any layout: columns of numbers, of times, and of lists of one length."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from testbed.importing.foreign_table import (
    MOST_COLUMNS,
    MOST_NUMBERS,
    ForeignTable,
    readable,
)


def read_file(path: Path) -> ForeignTable:
    """Columns of a Parquet file; instants and durations are in the unit of their type.

    Args:
        path: The file.

    Raises:
        RecordingError: It is damaged.
    """
    with readable(path):
        file = pq.ParquetFile(path, pre_buffer=False)
        schema, rows = file.schema_arrow, file.metadata.num_rows
        names = list(schema.names)
        widths = {
            f.name: _width(f, file.metadata) for f in schema if names.count(f.name) == 1
        }
        units = {f.name: u for f in schema if widths.get(f.name) and (u := _unit(f))}
        kept = {n: k for n, k in widths.items() if 0 < k <= MOST_COLUMNS and rows > 1}
        shapes = {n: (rows, k) if k > 1 else (rows,) for n, k in kept.items()}
    return ForeignTable(path, shapes, partial(read_column, file), units)


def _width(field: pa.Field, metadata: Any) -> int:
    """How many columns a column is; 0 if it is none."""
    kind = field.type
    if pa.types.is_fixed_size_list(kind):
        return int(kind.list_size) * _is_number(kind.value_type)
    if pa.types.is_list(kind) and _is_number(kind.value_type):
        groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
        parts = (each.column(k) for each in groups for k in range(each.num_columns))
        values = sum(
            int(p.num_values)
            for p in parts
            if p.path_in_schema.startswith(f"{field.name}.")
        )
        return values // max(int(metadata.num_rows), 1)
    return int(_is_number(kind) or _is_time(kind))


def _is_number(kind: pa.DataType) -> bool:
    numbers = (
        pa.types.is_floating(kind),
        pa.types.is_integer(kind),
        pa.types.is_boolean(kind),
    )
    return any(numbers)


def _is_time(kind: pa.DataType) -> bool:
    return bool(pa.types.is_timestamp(kind) or pa.types.is_duration(kind))


def _unit(field: pa.Field) -> str:
    """What the schema says of a column's unit."""
    if _is_time(field.type):
        return str(field.type.unit)
    return str((field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace"))


def read_column(file: pq.ParquetFile, name: str) -> NDArray[Any]:
    """A column, (M,), or (M, k) of lists.

    Args:
        file: An open file.
        name: Of the column.

    Raises:
        ValueError: A value is missing, or lists are of different lengths.
    """
    width = _width(file.schema_arrow.field(name), file.metadata)
    # a small file can hold as many equal ones
    if width * file.metadata.num_rows > MOST_NUMBERS:
        raise ValueError(f"column '{name}' has more than {MOST_NUMBERS:.0e} numbers")
    try:
        array = file.read([name]).column(0).combine_chunks()
    except (
        pa.ArrowInvalid
    ) as error:  # before version 26, of a list of one length that is missing
        raise ValueError(f"column '{name}': {error}") from None
    array = array.combine_chunks() if isinstance(array, pa.ChunkedArray) else array
    rows, kind = len(array), array.type
    missing, listed = (
        array.null_count,
        pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind),
    )
    if listed:
        lengths = np.unique(array.value_lengths().drop_null().to_numpy())
        if len(lengths) > 1:
            raise ValueError(
                f"lists of column '{name}' have {lengths[0]} to {lengths[-1]} values"
            )
        array = array.flatten()
        missing += array.null_count
    if missing and listed:
        raise ValueError(f"column '{name}' has {missing} places without a value")
    if _is_time(kind):
        array = array.cast(pa.int64())
    values = np.array(array.to_numpy(zero_copy_only=False))
    return values.reshape(rows, -1) if listed and values.size > rows else values
