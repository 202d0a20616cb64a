"""Parquet tables of other programs: numbers, times, truth values, lists; and places without any."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from testbed.errors import RecordingError
from testbed.recordings.importing.foreign_table import ForeignTable
from testbed.recordings.importing.foreign_units import TIMES
from testbed.recordings.importing.readers import open_foreign


def opened(folder: Path, **columns: Any) -> ForeignTable:
    """A file of these columns."""
    pq.write_table(pa.table(columns), folder / "log.parquet")
    return open_foreign(folder / "log.parquet")


@pytest.mark.parametrize(
    ("kind", "wanted"),
    [
        (pa.bool_(), [0.0, 1.0, 1.0]),
        (pa.int8(), [0.0, 1.0, 1.0]),
        (pa.uint64(), [0.0, 1.0, 1.0]),
        (pa.float32(), [0.0, 1.0, 1.0]),
        (pa.float64(), [0.0, 1.0, 1.0]),
    ],
)
def test_numbers_of_every_kind_are_columns(
    kind: pa.DataType, wanted: list[float], tmp_path: Path
) -> None:
    table = opened(tmp_path, x=pa.array([0, 1, 1]).cast(kind))
    (found,) = table.read(["x"]).values()
    assert found.dtype == np.float64
    assert found.tolist() == wanted


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_instants_and_durations_are_whole_numbers_of_their_unit(unit: str, tmp_path: Path) -> None:
    size = {"s": 1, "ms": 1000, "us": 10**6, "ns": 10**9}[unit]
    ticks = [2 * size, 3 * size, 5 * size]
    table = opened(
        tmp_path, at=pa.array(ticks, pa.timestamp(unit)), lasts=pa.array(ticks, pa.duration(unit))
    )
    for name in ("at", "lasts"):
        assert table.stamps(name).dtype == np.int64
        assert (table.stamps(name) * TIMES[table.units[name]]).tolist() == [2.0, 3.0, 5.0]


def test_lists_of_one_length_are_columns_by_number(tmp_path: Path) -> None:
    pairs = pa.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], pa.list_(pa.float64(), 2))
    table = opened(tmp_path, q=pairs, words=["a", "b", "c"])
    assert list(table.columns) == ["q[0]", "q[1]"]
    found = table.read(["q[1]", "q[0]"])
    assert found["q[0]"].tolist() == [1.0, 3.0, 5.0]
    assert found["q[1]"].tolist() == [2.0, 4.0, 6.0]


@pytest.mark.parametrize(
    "column",
    [
        pa.array([1.0, None, 3.0]),
        pa.array([[1.0, 2.0], [None, 4.0], [5.0, 6.0]], pa.list_(pa.float64(), 2)),
        pa.array([[1.0, 2.0], None, [5.0, 6.0]], pa.list_(pa.float64(), 2)),
    ],
)
def test_places_without_a_value_are_counted(column: pa.Array, tmp_path: Path) -> None:
    table = opened(tmp_path, x=column)
    with pytest.raises(RecordingError, match="column 'x' has 1 places without a value"):
        table.read(table.columns)
