"""Logs that would crash, hang or flood a reader: each is read or refused in a line that names it.

If one fails, a stranger's log ends the program without a word, fills the machine or is misread.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from benchmarks.hostile.case import write_files
from benchmarks.hostile.datasets import TRAPS
from benchmarks.hostile.logs import LOG_TRAPS, trap
from testbed.core.base.errors import RecordingError, UnknownName
from testbed.importing.foreign_table import MOST_COLUMNS, ForeignTable
from testbed.importing.readers import open_foreign, tables
from testbed.importing.source_clock import Times
from tests.helpers.refusals import refuses

SLOW = ("gzip", "MB", "9000", "12000", "20000", "3000", "wide", "many")
"""Words of traps that `python -m benchmarks hostile` makes."""


DATASETS = {name: make for name, make in TRAPS.items() if "200 MB" not in name}
LOGS = [name for name in LOG_TRAPS if not any(word in name for word in SLOW)]


def read_all(path: Path) -> None:
    """Whatever a reader finds, or a refusal of our own."""
    with suppress(RecordingError, UnknownName):
        for each in tables(path).values():
            if isinstance(each, ForeignTable):
                each.read(each.columns)


@pytest.mark.parametrize("name", [*LOGS, *DATASETS])
def test_a_trap_is_read_or_refused_by_name(name: str, tmp_path: Path) -> None:
    """Descriptors of themselves, chunks that lie, lists that grow: nothing but our own errors."""
    if name in DATASETS:
        files = DATASETS[name]()
        write_files(tmp_path, files, {})
        for file in files:
            read_all(tmp_path / file)
        return
    found = trap(name)
    write_files(tmp_path, found.files, found.links)
    if found.links:
        with refuses(RecordingError, found.name):
            tables(tmp_path / found.name)
    else:
        read_all(tmp_path / found.name)


def test_a_byte_that_crashes_the_library_of_matlab_files_is_a_refusal(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    savemat(path, {"time": np.arange(9.0)})
    data = bytearray(path.read_bytes())
    data[bytes(data).index(struct.pack("<II", 9, 72))] = 177
    path.write_bytes(data)
    with refuses(RecordingError, "log.mat"):
        open_foreign(path)


@pytest.mark.parametrize("ending", ["csv", "npz"])
def test_columns_are_taken_up_to_a_number_and_refused_beyond(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"log.{ending}"

    def written(count: int) -> Path:
        if ending == "csv":
            path.write_text((",".join(["1.5"] * count) + "\n") * 2)
        else:
            np.savez(path, q=np.ones((count + 1, count), "?"))
        return path

    assert len(open_foreign(written(200)).columns) == 200
    if ending == "csv":
        with refuses(RecordingError, path.name, str(MOST_COLUMNS)):
            open_foreign(written(MOST_COLUMNS + 5))
    with pytest.raises(RecordingError, match=str(MOST_COLUMNS)):
        ForeignTable(path, {"a": (2,), "b": (MOST_COLUMNS, MOST_COLUMNS)}, lambda _: None)


@pytest.mark.parametrize("first", [-(2**63), 2**63 - 1, 0])
@pytest.mark.parametrize("unit", ["s", "ms", "ns", "day"])
def test_stamps_at_the_ends_of_counters_are_times(first: int, unit: str) -> None:
    stamps = np.array([first, first], dtype=np.int64)
    found = Times.of(stamps, unit)
    assert np.isfinite(found.start)
    np.testing.assert_array_equal(np.diff(found.since), 0)
