"""A file yields columns and metadata, or says what is wrong with it, in one line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import testbed as tb
from testbed.errors import RecordingError
from testbed.recordings.recording import Recording
from tests.helpers.ideal import ideal
from tests.helpers.robots import random_robot


@pytest.fixture
def whole() -> Recording:
    tree = random_robot(np.random.default_rng(3), 2).tree()
    return ideal(tree, duration=2.0, rate=50.0)


def rewritten(path: Path, columns: dict[str, pa.Array] | None = None, metadata: Any = None) -> Path:
    """The same file with other columns or metadata."""
    table = pq.read_table(path)
    for name, values in (columns or {}).items():
        table = table.set_column(table.schema.get_field_index(name), name, values)
    if metadata is not None:
        text = metadata if isinstance(metadata, str) else json.dumps(metadata)
        table = table.replace_schema_metadata({"testbed": text})
    pq.write_table(table, path)
    return path


@pytest.mark.parametrize("kept", ["torque", "wrench"])
def test_torques_or_a_wrench_alone_come_back(kept: str, whole: Recording, tmp_path: Path) -> None:
    gone: dict[str, Any] = dict.fromkeys({"torque", "wrench"} - {kept})
    part = replace(whole, truth=None, **gone)
    part.save(tmp_path / "r.parquet")
    loaded = Recording.load(tmp_path / "r.parquet")
    assert loaded.signals == part.signals
    np.testing.assert_array_equal(loaded.measured(kept), whole.measured(kept))
    with pytest.raises(RecordingError, match="the recording has no"):
        loaded.measured(next(iter(gone)))
    assert tb.StoredRecording(tmp_path / "r.parquet").signals == part.signals


def test_the_ending_does_not_matter_where_the_content_tells(
    whole: Recording, tmp_path: Path
) -> None:
    whole.save(tmp_path / "r.parquet")
    (tmp_path / "r.parquet").rename(tmp_path / "r.v2")
    assert Recording.load(tmp_path / "r.v2").samples == whole.samples


def test_an_unknown_format_lists_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "r.doc").write_text("time\n")
    with pytest.raises(RecordingError, match=r"'.doc'.*known: .parquet.*testbed new --recording"):
        Recording.load(tmp_path / "r.doc")
    with pytest.raises(RecordingError, match="is no file"):
        Recording.load(tmp_path)


@pytest.mark.parametrize(
    "values",
    [
        pa.array([str(k) for k in range(100)]),
        pa.array(range(100), pa.duration("s")),
        pa.array(range(100), pa.timestamp("us")),
        pa.array(range(100), pa.decimal256(50, 2)),
        pa.array([None] * 100),
        pa.array([True] * 100),
        pa.array([[1.0]] * 100),
    ],
    ids=lambda values: str(values.type),
)
@pytest.mark.parametrize("column", ["time", "wrench/Fz"])
def test_columns_that_hold_no_numbers_are_named(
    column: str, values: pa.Array, whole: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "r.parquet"
    replace(whole, truth=None).save(path)
    rewritten(path, {column: values})
    for read in (Recording.load, tb.StoredRecording):
        with pytest.raises(RecordingError, match=f"'{column}' holds"):
            read(path)


def test_other_number_types_are_numbers(whole: Recording, tmp_path: Path) -> None:
    path = tmp_path / "r.parquet"
    replace(whole, truth=None).save(path)
    single = pa.array(whole.measured("wrench")[:, 2].astype(np.float32))
    found = Recording.load(rewritten(path, {"wrench/Fz": single}))
    np.testing.assert_allclose(found.measured("wrench"), whole.measured("wrench"), rtol=1e-6)


BAD = {
    "no table": [1, 2],
    "another layout": {"format": "testbed recording 99"},
    "facts are a list": {"facts": [1]},
    "tare too short": {"tare": [1, 2]},
    "tare of texts": {"tare": ["a"] * 6},
    "tare of truths": {"tare": [True] * 6},
    "tare too large": '{"tare": [' + "1" * 400 + ", 0, 0, 0, 0, 0]}",
    "tare not a number": '{"tare": [NaN, 0, 0, 0, 0, 0]}',
    "gravity of texts": {"facts": {"gravity": ["down", 0, 0]}},
    "gravity infinite": '{"facts": {"gravity": [Infinity, 0, 0]}}',
    "warnings no list": {"facts": {"warnings": "none"}},
    "warnings of numbers": {"facts": {"warnings": [3]}},
    "geometry a number": {"facts": {"geometry": 3}},
    "geometry of numbers": {"facts": {"geometry": {"j1": 3}}},
    "axis of texts": {"facts": {"geometry": {"j1": {"axis": "z"}}}},
    "axis of nulls": {"facts": {"geometry": {"j1": {"axis": [None, 0, 1]}}}},
    "rotation ragged": {"facts": {"geometry": {"j1": {"rotation": [[1, 0, 0], [0, 1], 3]}}}},
    "kind unknown": {"facts": {"geometry": {"j1": {"kind": "ball"}}}},
    "deep": "[" * 100_000 + "]" * 100_000,
    "no JSON": "{",
    "no text": '"\\ud800',
}


@pytest.mark.parametrize("metadata", BAD.values(), ids=BAD)
def test_damaged_metadata_are_refused_in_one_line(
    metadata: Any, whole: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "r.parquet"
    replace(whole, truth=None).save(path)
    rewritten(path, metadata=metadata)
    for read in (Recording.load, tb.StoredRecording):
        with pytest.raises(RecordingError, match="not a") as caught:
            read(path)
        assert "\n" not in str(caught.value)


def test_a_column_that_is_there_twice_is_named(whole: Recording, tmp_path: Path) -> None:
    path = tmp_path / "r.parquet"
    replace(whole, truth=None).save(path)
    table = pq.read_table(path)
    pq.write_table(table.append_column("time", table["time"]), path)
    with pytest.raises(RecordingError, match="'time' is there twice"):
        Recording.load(path)


@pytest.mark.parametrize("scale", [1e-12, 1e9, 1e300])
def test_times_that_are_no_seconds_are_named(
    scale: float, whole: Recording, tmp_path: Path
) -> None:
    replace(whole, time=whole.time * scale, truth=None).save(tmp_path / "r.parquet")
    with pytest.raises(RecordingError, match="is no sampling time|'time' is .* at sample"):
        Recording.load(tmp_path / "r.parquet")
