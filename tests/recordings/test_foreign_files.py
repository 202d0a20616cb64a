"""Every foreign format, written by its own library, is read back; damage and traps are refused."""

from __future__ import annotations

import gzip
import struct
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

import testbed as tb
from benchmarks.hostile.case import write_files
from benchmarks.hostile.datasets import TRAPS
from benchmarks.hostile.logs import LOG_TRAPS, trap
from testbed.core.base.errors import RecordingError, UnknownName
from testbed.importing.foreign_table import MAX_COLUMNS, TIME_UNITS, ForeignTable
from testbed.importing.guess import guess_mapping
from testbed.importing.readers import open_foreign_table, read_tables, ros_bag
from testbed.importing.source_clock import SourceTimes
from tests.helpers.foreign_files import EPOCH, FORMATS, JOINTS, some_log, write_c3d
from tests.helpers.refusals import refuses
from tests.helpers.strategies import few, rngs

STAMPS = 2.4e-7
"""Spacing of doubles at seconds since 1970 [s]."""


def filled(guess: str) -> str:
    """The guess as a person fills it in; velocities in these logs mean nothing."""
    head, _, rest = guess.partition("[velocity]")
    guess = head + rest[rest.index("[torque]") :] if rest else guess
    for empty, said in (("unit", '"rad"'), ("unit", '"N m"'), ("sense", '"on_robot"')):
        guess = guess.replace(f'{empty} = ""', f"{empty} = {said}", 1)
    return guess.replace('["", ""]', '["N", "N m"]')


@pytest.mark.parametrize("name", FORMATS)
def test_a_format_is_read_back_guessed_and_refused_where_it_is_damaged(
    name: str, tmp_path: Path
) -> None:
    """To the last bit; single precision and stamps since 1970 as far as they go."""
    log = some_log()
    (tmp_path / "map.toml").write_text(FORMATS[name](tmp_path, log))
    file = max(tmp_path.glob("log*"), key=lambda path: (path.is_file(), path.name))
    (tmp_path / "guess.toml").write_text(filled(guess_mapping([file], tmp_path, JOINTS).text))
    for mapping in ("map", "guess")[: 1 if name in ("csv", "c3d") else 2]:  # of columns a, b, c
        found = tb.import_recording(tmp_path / f"{mapping}.toml")
        np.testing.assert_allclose(found.time, log.t, rtol=0, atol=STAMPS)
        for signal, wanted in (("position", log.q), ("torque", log.tau), ("wrench", log.w)):
            exact = wanted.astype(np.float32) if name == "c3d" else wanted
            np.testing.assert_array_equal(found.measured(signal), exact)
        assert found.metadata.diagnostics == ()
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 3])
    if name == "csv":  # a logger that was stopped
        short = tb.import_recording(tmp_path / "map.toml")
        assert [d.code for d in short.metadata.diagnostics] == ["import.incomplete"]
        np.testing.assert_array_equal(short.position, log.q[: short.samples])
        file.write_bytes(data[: len(data) // 3] + b",\n" + data[len(data) // 3 :])
    with refuses(RecordingError, "log."):
        tb.import_recording(tmp_path / "map.toml")


def test_tables_of_text_are_read_as_loggers_write_them(tmp_path: Path) -> None:
    """Separators, decimal commas, preambles, quotes, doubled names, words; packed, in Latin-1."""
    cases: list[tuple[str, dict[str, list[float]]]] = [
        ("1 2\n3 4\n5 6\n", {"0": [1, 3, 5], "1": [2, 4, 6]}),
        ("a;b\n1,5;2\n3;4,25\n", {"a": [1.5, 3], "b": [2, 4.25]}),
        ('% by a logger\n"a","b"\n1,2\n3,4\n', {"a": [1, 3], "b": [2, 4]}),
        ("speed of all\na\tb\ta\n1\t2\t3\n4\t5\t6\n", {"a": [1, 4], "b": [2, 5], "a (2)": [3, 6]}),
        ("# größe b\n1 2\n3 4\n", {"größe": [1, 3], "b": [2, 4]}),
        ("t,what,b\n0,on,2\n1,off,4\n", {"t": [0, 1], "b": [2, 4]}),
        (
            "of;scope\nRate;100\n\nt;q\n1,5;2\n1,75;3\n2;4\n2,25;5\n2,5;6\n2,75;6\n",
            {"t": [1.5, 1.75, 2, 2.25, 2.5, 2.75], "q": [2, 3, 4, 5, 6, 6]},
        ),
        ("0,5 2\n0,75 3\n1 4,5\n", {"0": [0.5, 0.75, 1], "1": [2, 3, 4.5]}),
        ('"F, x","b"\n1,2\n3,4\n', {"F, x": [1, 3], "b": [2, 4]}),
    ]
    for text, wanted in cases:
        (tmp_path / "log.txt").write_bytes(text.encode("latin-1"))
        (tmp_path / "log.csv.gz").write_bytes(gzip.compress(text.encode()))
        for name in ("log.txt", "log.csv.gz"):
            table = open_foreign_table(tmp_path / name)
            assert table.columns == tuple(wanted)
            read = table.column_values(table.columns)
            assert {key: values.tolist() for key, values in read.items()} == wanted
    ticks = [1_761_234_567_000_000_001 + 10**7 * k for k in range(4)]  # more digits than doubles
    (tmp_path / "log.csv").write_text("t,q\n" + "".join(f"{tick},1\n" for tick in ticks))
    assert open_foreign_table(tmp_path / "log.csv").time_stamps("t").tolist() == ticks
    np.save(tmp_path / "log.npy", np.arange(6.0).reshape(3, 2))
    assert open_foreign_table(tmp_path / "log.npy").column_values(["array[1]"])[
        "array[1]"
    ].tolist() == [
        1,
        3,
        5,
    ]


@given(rng=rngs, style=st.sampled_from([(",", "."), (";", ","), ("\t", ".")]), word=st.booleans())
def test_a_field_that_is_no_number_is_named_by_line_and_column_and_an_empty_one_is_nan(
    rng: np.random.Generator, style: tuple[str, str], word: bool,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:  # fmt: skip
    """Comments and a preamble count as lines."""
    separator, point = style
    numbers = rng.normal(size=(30, 4))
    row, column = int(rng.integers(1, 30)), int(rng.integers(0, 4))
    rows = [[f"{x:.6f}".replace(".", point) for x in each] for each in numbers]
    rows[row][column] = "off" if word else ""
    lines = ["of a logger", separator.join("abcd"), *map(separator.join, rows)]
    lines.insert(10, "# a comment")
    path = tmp_path_factory.mktemp("text") / "log.csv"
    path.write_text("\n".join(lines))
    if word:
        number = lines.index(separator.join(rows[row])) + 1
        with refuses(RecordingError, f"line {number}:", f"'{'abcd'[column]}'"):
            open_foreign_table(path).column_values("abcd")
        others = "abcd".replace("abcd"[column], "")
        assert [*open_foreign_table(path).column_values(others)] == [*others]
    else:
        numbers[row, column] = np.nan
        read = open_foreign_table(path).column_values(list("abcd"))
        np.testing.assert_allclose(np.stack(list(read.values()), axis=1), numbers, atol=1e-6)


def test_traps_in_files_are_not_opened(tmp_path: Path) -> None:
    """Pickles, links to other files, arrays larger than memory, words and volumes of MATLAB."""
    np.savez(tmp_path / "log.npz", q=np.arange(3.0), bad=np.array([{}], dtype=object))
    assert open_foreign_table(tmp_path / "log.npz").columns == ("q",)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = np.arange(5.0)
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["link"] = h5py.ExternalLink("other.h5", "secret")
        layout = h5py.VirtualLayout((5,), "f8")
        layout[:] = h5py.VirtualSource("other.h5", "secret", (5,))
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("q", (10**9, 2), "f8", chunks=(1024, 2))
        file.create_dataset("picture", (10**8, 10**8), "f8", chunks=(16, 16))
    table = open_foreign_table(tmp_path / "log.h5")
    assert table.columns == ("q[0]", "q[1]")
    with refuses(RecordingError, "log.h5"):
        table.column_values(["q[0]"])
    content = {"q": np.arange(6.0).reshape(3, 2), "note": "by hand", "volume": np.zeros((2, 2, 2)),
               "log": {"t": np.arange(3.0), "who": "me"}}  # fmt: skip
    savemat(tmp_path / "log.mat", content)
    columns = {name.split("[")[0] for name in open_foreign_table(tmp_path / "log.mat").columns}
    assert columns == {"q", "log/t"}


def test_files_that_hold_no_log_and_libraries_that_are_missing_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, data in (("a.csv", b""), ("b.csv", b"words\nand words\n"), ("c.csv", b"1,2\n\0\n"),
                       ("a.c3d", b"\2\x50" + bytes(9)), ("a.xls", b"1"), ("a.", b"1")):  # fmt: skip
        (tmp_path / name).write_bytes(data)
        with pytest.raises((RecordingError, UnknownName), match=name[1:]):
            open_foreign_table(tmp_path / name)
    for nothing in (tmp_path, tmp_path / "none.csv"):
        with refuses(RecordingError, nothing.name):
            open_foreign_table(nothing)
    FORMATS["bag"](tmp_path, some_log())
    with refuses(RecordingError, "/joint_states", "/plate"):
        open_foreign_table(tmp_path / "log.bag", "/joints")
    plate = open_foreign_table(tmp_path / "log.bag", "/plate")
    assert plate.column_values(["received"])["received"][0] == EPOCH
    with refuses(UnknownName, "'wrench/force/w'"):
        plate.column_values(["wrench/force/w"])
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)  # as where it is not installed
    with refuses(RecordingError, "rosbags", "[import]"):
        ros_bag.tables(tmp_path / "log.bag", "/plate")


def test_parquet_tables_of_other_programs_hold_numbers_times_truths_and_lists(
    tmp_path: Path,
) -> None:
    def opened(**columns: Any) -> ForeignTable:
        pq.write_table(pa.table(columns), tmp_path / "log.parquet")
        return open_foreign_table(tmp_path / "log.parquet")

    kinds = (pa.bool_(), pa.int8(), pa.uint64(), pa.float32(), pa.float64())
    table = opened(**{f"{kind}": pa.array([0, 1, 1]).cast(kind) for kind in kinds})
    for values in table.column_values(table.columns).values():
        assert values.dtype == np.float64
        assert values.tolist() == [0.0, 1.0, 1.0]
    for unit, size in {"s": 1, "ms": 1000, "us": 10**6, "ns": 10**9}.items():
        for kind in (pa.timestamp, pa.duration):
            table = opened(t=pa.array([2 * size, 3 * size, 5 * size], kind(unit)))
            assert table.time_stamps("t").dtype == np.int64
            assert (table.time_stamps("t") * TIME_UNITS[table.units["t"]]).tolist() == [
                2.0,
                3.0,
                5.0,
            ]
    pairs = pa.list_(pa.float64(), 2)
    table = opened(q=pa.array([[1.0, 2.0], [3.0, 4.0]], pairs), words=["a", "b"])
    assert table.columns == ("q[0]", "q[1]")
    assert table.column_values(["q[1]"])["q[1]"].tolist() == [2.0, 4.0]
    np.testing.assert_array_equal(
        opened(x=pa.array([1.0, None])).column_values(["x"])["x"], [1.0, np.nan]
    )
    value, pair = [[1.0, None], [3.0, 4.0]], [[1.0, 2.0], None]  # pairs: by old versions' own word
    for hole, count in ((value, "1 places"), (pair, "")):
        table = opened(x=pa.array(hole, pairs))
        with refuses(RecordingError, "column 'x'", count):
            table.column_values(table.columns)


POLYGON = "geometry_msgs/msg/Polygon"


@few(4)
@given(version=st.sampled_from([1, 2]), rng=rngs)
def test_ros_messages_are_numbers_by_their_paths(
    version: int, rng: np.random.Generator, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Lists of messages; lists that grow, and lengths that lie, are none."""
    store = get_typestore({1: Stores.ROS1_NOETIC, 2: Stores.ROS2_HUMBLE}[version])
    point = store.types["geometry_msgs/msg/Point32"]
    pack: Any = store.serialize_ros1 if version == 1 else store.serialize_cdr

    def polygon(points: Any) -> bytes:
        each = [point(*map(float, xyz)) for xyz in points]
        return bytes(pack(store.types[POLYGON](each), POLYGON))

    def opened(messages: list[bytes]) -> ForeignTable:
        path = tmp_path_factory.mktemp("bag") / ("log.bag" if version == 1 else "log")
        kind: Any = {"version": 9, "storage_plugin": StoragePlugin.MCAP}
        writer: Any = Writer1(path) if version == 1 else Writer(path, **kind)
        with writer:
            topic = writer.add_connection("/told", POLYGON, typestore=store)
            for k, message in enumerate(messages):
                writer.write(topic, EPOCH + k * 10_000_000, message)
        return open_foreign_table(path, "/told")

    points = rng.normal(size=(5, 3, 3)).astype(np.float32)
    names = [f"points[{k}]/{axis}" for k in range(3) for axis in "xyz"]
    found = opened([polygon(each) for each in points]).column_values(names)
    for name, values in zip(names, points.reshape(5, 9).T, strict=True):
        np.testing.assert_array_equal(found[name], values)
    with refuses(RecordingError, "points[2]/x"):
        opened([polygon(np.ones((k, 3))) for k in (2, 2, 3)])
    data, start = polygon(np.ones((2, 3))), 0 if version == 1 else 4
    for count in (10**6, 3):
        wrong = data[:start] + count.to_bytes(4, "little") + data[start + 4 :]
        with refuses(RecordingError):
            opened([wrong])


def test_a_c3d_file_has_points_beside_channels_with_units_names_and_what_was_not_seen(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(0)
    place, force = rng.normal(size=(3, 2, 6)), rng.normal(size=(4, 6))
    place[:, 0, 2] = np.nan
    write_c3d(
        tmp_path / "log.c3d", force, place,
        ANALOG={"LABELS": ("Fx", "Fx", "", "My"), "UNITS": ("N", "N", "", "Nmm")},
        POINT={"LABELS": ("m", "n"), "UNITS": ("mm",)},
    )  # fmt: skip
    table = open_foreign_table(tmp_path / "log.c3d")
    wanted = dict(zip(("analog/Fx", "analog/Fx (1)", "analog/2", "analog/My"), force, strict=True))
    points = [f"point/{name}/{axis}" for name in "mn" for axis in "xyz"]
    wanted |= dict(zip(points, place.transpose(1, 0, 2).reshape(6, 6), strict=True))
    wanted |= dict.fromkeys(("analog/time", "point/time"), np.arange(6) / 100.0)
    read = table.column_values(table.columns)
    assert read.keys() == wanted.keys()
    for name, values in wanted.items():
        np.testing.assert_allclose(read[name], values, rtol=1e-6)
    units = {"analog/time": "s", "point/time": "s", "analog/Fx": "N", "analog/My": "Nmm"}
    units["analog/Fx (1)"] = "N"
    assert table.units == units | dict.fromkeys(points, "mm")


SLOW = ("gzip", "MB", "9000", "12000", "20000", "3000", "wide", "many")
"""Words of traps that `python -m benchmarks hostile` makes."""


DATASETS = {name: make for name, make in TRAPS.items() if "200 MB" not in name}
LOGS = [name for name in LOG_TRAPS if not any(word in name for word in SLOW)]


def read_all(path: Path) -> None:
    """Whatever a reader finds, or a refusal of our own."""
    with suppress(RecordingError, UnknownName):
        for each in read_tables(path).values():
            if isinstance(each, ForeignTable):
                each.column_values(each.columns)


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
            read_tables(tmp_path / found.name)
    else:
        read_all(tmp_path / found.name)


def test_a_byte_that_crashes_the_library_of_matlab_files_is_a_refusal(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    savemat(path, {"time": np.arange(9.0)})
    data = bytearray(path.read_bytes())
    data[bytes(data).index(struct.pack("<II", 9, 72))] = 177
    path.write_bytes(data)
    with refuses(RecordingError, "log.mat"):
        open_foreign_table(path)


@pytest.mark.parametrize("ending", ["csv", "npz"])
def test_columns_are_taken_up_to_a_number_and_refused_beyond(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"log.{ending}"

    def written(count: int) -> Path:
        if ending == "csv":
            path.write_text((",".join(["1.5"] * count) + "\n") * 2)
        else:
            np.savez(path, q=np.ones((count + 1, count), "?"))
        return path

    assert len(open_foreign_table(written(200)).columns) == 200
    if ending == "csv":
        with refuses(RecordingError, path.name, str(MAX_COLUMNS)):
            open_foreign_table(written(MAX_COLUMNS + 5))
    with pytest.raises(RecordingError, match=str(MAX_COLUMNS)):
        ForeignTable(path, {"a": (2,), "b": (MAX_COLUMNS, MAX_COLUMNS)}, lambda _: None)


@pytest.mark.parametrize("first", [-(2**63), 2**63 - 1, 0])
@pytest.mark.parametrize("unit", ["s", "ms", "ns", "day"])
def test_stamps_at_the_ends_of_counters_are_times(first: int, unit: str) -> None:
    stamps = np.array([first, first], dtype=np.int64)
    found = SourceTimes.from_stamps(stamps, unit)
    assert np.isfinite(found.start)
    np.testing.assert_array_equal(np.diff(found.time_after_start), 0)
