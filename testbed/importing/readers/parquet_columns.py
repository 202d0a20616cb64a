"""Parquet files of any layout: columns of numbers, times and lists of equal length."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from testbed.importing.foreign_table import (
    MAX_COLUMNS,
    MAX_NUMBERS,
    ForeignTable,
    reading_errors_as_recording_errors,
)


def read_file(path: Path) -> ForeignTable:
    """Read the columns of a Parquet file; times keep the unit of their type.

    Args:
        path: Path of the file.

    Raises:
        RecordingError: The file is damaged.
    """
    with reading_errors_as_recording_errors(path):
        file = pq.ParquetFile(path, pre_buffer=False)
        schema, rows = file.schema_arrow, file.metadata.num_rows
        names = list(schema.names)
        widths = {
            f.name: _column_count(f, file.metadata)
            for f in schema
            if names.count(f.name) == 1
        }
        units = {
            f.name: u for f in schema if widths.get(f.name) and (u := _stated_unit(f))
        }
        used_widths = {
            n: k for n, k in widths.items() if 0 < k <= MAX_COLUMNS and rows > 1
        }
        shapes = {n: (rows, k) if k > 1 else (rows,) for n, k in used_widths.items()}
    return ForeignTable(path, shapes, partial(read_column, file), units)


def _column_count(field: pa.Field, metadata: Any) -> int:
    """Number of columns that a field of the schema becomes; 0 if not numeric.

    It is the length of the lists in the field (the mean length if the type does not fix it), and 1
    for other numeric fields.
    """
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
    """Test whether a type is numeric or boolean."""
    numbers = (
        pa.types.is_floating(kind),
        pa.types.is_integer(kind),
        pa.types.is_boolean(kind),
    )
    return any(numbers)


def _is_time(kind: pa.DataType) -> bool:
    """Test whether a type is an instant or a duration."""
    return bool(pa.types.is_timestamp(kind) or pa.types.is_duration(kind))


def _stated_unit(field: pa.Field) -> str:
    """Unit of a time's type, or unit in a column's metadata; otherwise empty."""
    if _is_time(field.type):
        return str(field.type.unit)
    return str((field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace"))


def read_column(file: pq.ParquetFile, name: str) -> NDArray[Any]:
    """Values of a column, (M,), or (M, k) for lists.

    Instants and durations become integers in the unit of their type.

    Args:
        file: Open file.
        name: Column name.

    Raises:
        ValueError: A value in a list is missing, lists differ in length, or there are more than
            `MAX_NUMBERS` values.
    """
    width = _column_count(file.schema_arrow.field(name), file.metadata)
    # a small file can hold many equal values, compressed
    if width * file.metadata.num_rows > MAX_NUMBERS:
        raise ValueError(f"column '{name}' has more than {MAX_NUMBERS:.0e} numbers")
    try:
        array = file.read([name]).column(0).combine_chunks()
    except pa.ArrowInvalid as error:  # pyarrow before 26: missing list of fixed size
        raise ValueError(f"column '{name}': {error}") from None
    array = array.combine_chunks() if isinstance(array, pa.ChunkedArray) else array
    rows, kind = len(array), array.type
    missing_count, is_list = (
        array.null_count,
        pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind),
    )
    if is_list:
        lengths = np.unique(array.value_lengths().drop_null().to_numpy())
        if len(lengths) > 1:
            raise ValueError(
                f"lists of column '{name}' have {lengths[0]} to {lengths[-1]} values"
            )
        array = array.flatten()
        missing_count += array.null_count
    if missing_count and is_list:
        raise ValueError(f"column '{name}' has {missing_count} places without a value")
    if _is_time(kind):
        array = array.cast(pa.int64())
    values = np.array(array.to_numpy(zero_copy_only=False))
    return values.reshape(rows, -1) if is_list and values.size > rows else values
