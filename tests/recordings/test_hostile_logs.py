"""Logs that would crash, hang or flood a reader: each is read or refused in a line that names it.

If one fails, a stranger's log ends the program without a word, fills the machine or is misread.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

import testbed as tb
from benchmarks.hostile.case import write_files
from benchmarks.hostile.logs import LOG_TRAPS, trap
from testbed.core.base.errors import RecordingError, UnknownName
from testbed.core.recordings.source import open_source
from testbed.importing.foreign_table import MOST_COLUMNS, ForeignTable
from testbed.importing.guess import guessed
from testbed.importing.readers import open_foreign, tables
from testbed.importing.source_clock import Times
from tests.helpers.foreign_files import FORMATS, some_log
from tests.helpers.refusals import refuses

SLOW = ("gzip", "MB", "9000", "12000", "20000", "3000", "wide", "many")
"""Words of traps that `python -m benchmarks hostile` makes."""


@pytest.mark.parametrize("name", [n for n in LOG_TRAPS if not any(w in n for w in SLOW)])
def test_a_trap_is_read_or_refused_by_name(name: str, tmp_path: Path) -> None:
    found = trap(name)
    write_files(tmp_path, found.files, found.links)
    if found.links:
        with refuses(RecordingError, found.name):
            tables(tmp_path / found.name)
        return
    with suppress(RecordingError, UnknownName):
        for each in tables(tmp_path / found.name).values():
            if isinstance(each, ForeignTable):
                each.read(each.columns)


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


@pytest.mark.parametrize("lost", [1, 2, 8, 14])
def test_a_line_that_ends_early_is_left_out_and_said(lost: int, tmp_path: Path) -> None:
    """Of numbers with as many digits each; a file without a last line's end is whole."""
    log = some_log()
    text = "".join(
        ",".join(f"{x:.6f}" for x in (t, *q, *tau)) + "\n"
        for t, q, tau in zip(log.t - log.t[0], log.q, log.tau, strict=True)
    )
    path = tmp_path / "log.csv"
    path.write_text(text[:-1])
    whole = open_foreign(path)
    assert not whole.cut
    path.write_text(text[: -1 - lost])
    found = open_foreign(path)
    assert found.cut
    for name, values in found.read(found.columns).items():
        np.testing.assert_array_equal(values, whole.read([name])[name][:-1])
    assert f"{len(log.t) - 1} rows" in guessed([path], tmp_path).text


def write_log(folder: Path, old: str = "", new: str = "") -> None:
    """A log and its mapping, some text of which is changed."""
    text = FORMATS["csv"](folder, some_log())
    assert old in text
    (folder / "map.toml").write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new"),
    [('file = "log.csv"', 'file = "none.csv"'), ('time = "', 'time = "no'),
     ("rate = 100", "rate = 1e-6"), ("rate = 100", "start = 1000\nrate = 100")],
)  # fmt: skip
def test_errors_of_data_name_the_mapping_and_the_data(old: str, new: str, tmp_path: Path) -> None:
    write_log(tmp_path, old, new)
    data = "none.csv" if "none" in new else "log.csv"
    with refuses((RecordingError, UnknownName), "map.toml", data):  # type: ignore[arg-type]
        tb.import_recording(tmp_path / "map.toml")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e13])
@pytest.mark.parametrize("signal", ["torque", "position", "wrench"])
def test_a_value_that_is_no_measurement_is_refused_wherever_a_part_is_read(
    value: float, signal: str, tmp_path: Path
) -> None:
    write_log(tmp_path)
    path = tmp_path / "log.parquet"
    tb.import_recording(tmp_path / "map.toml").save(path)
    table = pq.read_table(path)
    name = next(c for c in table.column_names if c.startswith(signal))
    values = table[name].to_numpy().copy()
    values[37] = value
    place = table.schema.get_field_index(name)
    pq.write_table(table.set_column(place, table.schema.field(name), [values]), path)
    source = open_source(path)
    with refuses(RecordingError, "log.parquet", name, "37"):
        source.part(30, 50)


@pytest.mark.parametrize("first", [-(2**63), 2**63 - 1, 0])
@pytest.mark.parametrize("unit", ["s", "ms", "ns", "day"])
def test_stamps_at_the_ends_of_counters_are_times(first: int, unit: str) -> None:
    stamps = np.array([first, first], dtype=np.int64)
    found = Times.of(stamps, unit)
    assert np.isfinite(found.start)
    np.testing.assert_array_equal(np.diff(found.since), 0)
