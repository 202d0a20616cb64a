"""Parquet files of any layout: columns of numbers, of times, and of lists of one length."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from testbed.recordings.importing.foreign_table import ForeignTable, readable


def read_file(path: Path, topic: str | None) -> ForeignTable:
    """Columns of a Parquet file; instants and durations are in the unit of their type.

    Args:
        path: The file.
        topic: None.

    Raises:
        RecordingError: It is damaged.
    """
    del topic
    with readable(path):
        file = pq.ParquetFile(path, pre_buffer=False)
        schema, rows = file.schema_arrow, file.metadata.num_rows
        names = list(schema.names)
        fields = [f for f in schema if names.count(f.name) == 1 and _width(f.type) and rows > 1]
        units = {f.name: u for f in fields if (u := _unit(f))}
        shapes = {f.name: (rows, _width(f.type)) if _width(f.type) > 1 else (rows,) for f in fields}
    return ForeignTable(path, shapes, lambda name: _column(path, name), units)


def _width(kind: pa.DataType) -> int:
    """How many columns a column is; 0 if it is none."""
    if pa.types.is_fixed_size_list(kind):
        return int(kind.list_size) * bool(_width(kind.value_type) == 1)
    numbers = (pa.types.is_floating(kind), pa.types.is_integer(kind), pa.types.is_boolean(kind))
    return int(any(numbers) or pa.types.is_timestamp(kind) or pa.types.is_duration(kind))


def _unit(field: pa.Field) -> str:
    """What the schema says of a column's unit."""
    if pa.types.is_timestamp(field.type) or pa.types.is_duration(field.type):
        return str(field.type.unit)
    return str((field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace"))


def _column(path: Path, name: str) -> NDArray[Any]:
    """A column, (M,) or (M, k)."""
    column = pq.ParquetFile(path, pre_buffer=False).read([name]).column(0)
    if column.null_count:
        raise ValueError(f"column '{name}' has {column.null_count} places without a value")
    kind, array = column.type, column.combine_chunks()
    array = array.combine_chunks() if isinstance(array, pa.ChunkedArray) else array
    if pa.types.is_fixed_size_list(kind):
        values = array.flatten()
        if values.null_count:
            raise ValueError(f"column '{name}' has {values.null_count} places without a value")
        return np.array(values.to_numpy(zero_copy_only=False), float).reshape(-1, kind.list_size)
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        whole = array.cast(pa.int64()).to_numpy()
        return np.array(whole)
    return np.array(array.to_numpy(zero_copy_only=False))
