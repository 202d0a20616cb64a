"""Recordings that stay in their file, and parts of one that come in turn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.recordings.formats import parquet
from testbed.recordings.formats.parquet import ParquetTable
from testbed.recordings.recording import Recording
from testbed.recordings.source import gathered, open_source
from testbed.recordings.stored import write_parts
from tests.helpers.ideal import ideal
from tests.helpers.robots import random_robot

SIZE = 130


@pytest.fixture(scope="module")
def whole() -> Recording:
    tree = random_robot(np.random.default_rng(3), 2).tree()
    made = ideal(tree, duration=10.0, rate=100.0)
    return replace(made, tare=np.arange(6.0), facts={"robot": "r"})


@pytest.fixture(scope="module")
def path(whole: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """In row groups of 130 samples; the last is shorter."""
    path = tmp_path_factory.mktemp("stored") / "r.parquet"
    write_parts(cut(whole), path)
    groups = pq.ParquetFile(path).metadata
    assert groups.num_row_groups == -(-whole.samples // SIZE)
    return path


def cut(whole: Recording) -> list[Recording]:
    return [
        whole.part(first, min(first + SIZE, whole.samples))
        for first in range(0, whole.samples, SIZE)
    ]


def same(one: Recording, other: Recording) -> None:
    assert one.names == other.names
    assert one.columns().keys() == other.columns().keys()
    for name, values in one.columns().items():
        np.testing.assert_array_equal(values, other.columns()[name])
    np.testing.assert_array_equal(one.tare, other.tare)
    assert one.facts == other.facts


def test_a_stored_recording_says_what_the_whole_one_says(whole: Recording, path: Path) -> None:
    stored = tb.StoredRecording(path)
    assert (stored.names, stored.samples, stored.facts) == (whole.names, whole.samples, whole.facts)
    assert (stored.signals, stored.senses_kinematics) == (whole.signals, True)
    assert stored.rate == pytest.approx(whole.rate, rel=1e-12)
    np.testing.assert_array_equal(stored.tare, whole.tare)


def test_parts_come_in_any_order_and_of_any_size(whole: Recording, path: Path) -> None:
    """Forward, across row groups, back to the beginning, the same again, the last sample."""
    stored = tb.StoredRecording(path)
    n = whole.samples
    spans = [(0, 10), (10, 400), (390, 700), (129, 131), (130, 260), (130, 260), (5, 6), (0, n)]
    spans += [(n - 1, n), (259, 261), (0, 0), (n, n)]
    for first, last in spans:
        same(stored.part(first, last), whole.part(first, last))


def test_the_truth_is_not_read_but_kept(whole: Recording, tmp_path: Path) -> None:
    truth = whole.truth
    assert truth is not None
    parts = [
        replace(
            part,
            truth=replace(truth, **{k: v[at : at + SIZE] for k, v in vars(truth).items()}),
        )
        for at, part in zip(range(0, whole.samples, SIZE), cut(whole), strict=True)
    ]
    write_parts(parts, tmp_path / "r.parquet")
    assert tb.StoredRecording(tmp_path / "r.parquet").part(0, 5).truth is None
    loaded = Recording.load(tmp_path / "r.parquet")
    assert loaded.true_columns().keys() == whole.true_columns().keys()
    for name, values in whole.true_columns().items():
        np.testing.assert_array_equal(loaded.true_columns()[name], values)


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_short_files_have_no_rate_or_that_of_their_two_samples(
    samples: int, whole: Recording, tmp_path: Path
) -> None:
    whole.part(0, samples).save(tmp_path / "r.parquet")
    stored = tb.StoredRecording(tmp_path / "r.parquet")
    assert stored.samples == samples
    assert stored.rate == pytest.approx(100.0 if samples == 2 else 0.0)


def test_times_that_stand_still_have_no_rate(whole: Recording, tmp_path: Path) -> None:
    replace(whole, time=np.zeros(whole.samples)).save(tmp_path / "r.parquet")
    assert tb.StoredRecording(tmp_path / "r.parquet").rate == 0.0


@pytest.mark.parametrize("step", [1e-323, 1e-12, 1e9, 1e300])
def test_times_that_are_no_seconds_are_refused_when_the_file_is_opened(
    step: float, whole: Recording, tmp_path: Path
) -> None:
    """A rate is a number that filters can be made for."""
    replace(whole, time=whole.time * 100.0 * step).save(tmp_path / "r.parquet")
    with pytest.raises(RecordingError, match="is no sampling time; time is in seconds"):
        tb.StoredRecording(tmp_path / "r.parquet")


@pytest.mark.parametrize("at_once", [1, 7, SIZE, 10**6])
def test_a_recording_is_read_whole_by_parts_of_any_size(
    at_once: int, whole: Recording, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader, which may hold what it is asked for, is never asked for more."""
    asked = []
    read = ParquetTable.read

    def noted(table: ParquetTable, columns: list[str], first: int, last: int) -> dict[str, Array]:
        asked.append(last - first)
        return read(table, columns, first, last)

    monkeypatch.setattr(ParquetTable, "read", noted)
    monkeypatch.setattr("testbed.recordings.recording.AT_ONCE", at_once)
    same(Recording.load(path), whole)
    assert max(asked) == min(at_once, whole.samples)
    assert sum(asked) == whole.samples


def test_parts_in_memory_are_gathered_into_one(whole: Recording) -> None:
    """What was not measured stays so; nothing is kept in memory."""
    found = gathered(iter(cut(whole)))
    same(found, whole)
    assert isinstance(found.position.base, np.memmap | np.ndarray)
    assert not found.position.flags.owndata
    alone = gathered(part for part in cut(replace(whole, torque=None, truth=None)))
    assert "torque" not in alone.signals


def test_a_source_is_opened_for_what_it_is(whole: Recording, path: Path) -> None:
    stored = tb.StoredRecording(path)
    assert open_source(whole) is whole
    assert open_source(stored) is stored
    for named in (path, str(path)):
        assert isinstance(open_source(named), tb.StoredRecording)
    same(open_source(cut(whole)).part(0, whole.samples), whole)


def test_parts_of_two_recordings_are_refused(whole: Recording, tmp_path: Path) -> None:
    first, second, *_ = cut(whole)
    for other in (
        replace(second, names=("x", "y")),
        replace(second, torque=None),
        replace(second, truth=whole.truth),
    ):
        with pytest.raises(RecordingError, match="have different channels"):
            gathered([first, other])
        with pytest.raises(RecordingError, match="have different channels"):
            write_parts([first, other], tmp_path / "r.parquet")
    with pytest.raises(RecordingError, match="has no parts"):
        gathered([])


def test_metadata_of_any_length_are_not_read(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet, "MOST_METADATA", 20)
    with pytest.raises(RecordingError, match=r"its metadata have .* bytes, more than 2e\+01"):
        tb.StoredRecording(path)


def test_numbers_are_kept_byte_by_byte_and_packed(path: Path) -> None:
    """Which makes files of measurements a good deal smaller."""
    column = pq.ParquetFile(path).metadata.row_group(0).column(1)
    assert "BYTE_STREAM_SPLIT" in column.encodings
    assert column.compression == "ZSTD"
