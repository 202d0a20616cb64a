"""Every foreign format, written by its own library and read back."""

from __future__ import annotations

import builtins
import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

import testbed as tb
from testbed.errors import RecordingError, UnknownName
from testbed.recordings.importing.readers import open_foreign
from tests.helpers.foreign_files import EPOCH, FORMATS, SINGLE, some_log, write_c3d

STAMPS = 2.4e-7
"""Spacing of doubles at seconds since 1970 [s]."""


@pytest.mark.parametrize("name", FORMATS)
def test_a_format_is_read_back(name: str, tmp_path: Path) -> None:
    """To the last bit; single precision and stamps since 1970 as far as they go."""
    log = some_log()
    (tmp_path / "map.toml").write_text(FORMATS[name](tmp_path, log))
    found = tb.Recording.from_mapping(tmp_path / "map.toml")
    np.testing.assert_allclose(found.time, log.t, rtol=0, atol=STAMPS)
    for signal, wanted in (("position", log.q), ("torque", log.tau), ("wrench", log.w)):
        exact = wanted.astype(np.float32) if name in SINGLE else wanted
        np.testing.assert_array_equal(found.measured(signal), exact)
    assert found.facts.get("warnings") is None


@pytest.mark.parametrize("name", [name for name in FORMATS if name != "mcap"])
def test_a_file_cut_short_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(FORMATS[name](tmp_path, some_log()))
    (file,) = (p for p in tmp_path.glob("log.*") if p.is_file())
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 3])
    if name == "csv":  # a shorter table is a table
        file.write_bytes(data[: len(data) // 3] + b",")
    with pytest.raises(RecordingError, match=r"log\.") as found:
        tb.Recording.from_mapping(tmp_path / "map.toml")
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("1 2\n3 4\n5 6\n", ("0", "1")),
        ("a;b\n1,5;2\n3;4,25\n", ("a", "b")),
        ('% by a logger\n"a","b"\n1,2\n3,4\n', ("a", "b")),
        ("speed of all\na\tb\ta\n1\t2\t3\n4\t5\t6\n", ("a", "b", "a (2)")),
        ("# a b\n1 2\n3 4\n", ("a", "b")),
        ("t,what,b\n0,on,2\n1,off,4\n", ("t", "b")),
    ],
)
def test_tables_of_text_as_loggers_write_them(
    text: str, columns: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "log.txt"
    path.write_text(text)
    packed = tmp_path / "log.csv.gz"
    packed.write_bytes(gzip.compress(text.encode()))
    for table in (open_foreign(path), open_foreign(packed)):
        assert table.columns == columns
        assert all(np.isfinite(values).all() for values in table.read(columns).values())


def test_a_decimal_comma_is_a_decimal_point(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("a;b\n1,5;2\n3;4,25\n")
    found = open_foreign(tmp_path / "log.csv").read(["a", "b"])
    assert found["a"].tolist() == [1.5, 3.0]
    assert found["b"].tolist() == [2.0, 4.25]


def test_pickles_are_not_opened(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", q=np.arange(3.0), bad=np.array([{}], dtype=object))
    table = open_foreign(tmp_path / "log.npz")
    assert table.columns == ("q",)


def test_links_to_other_files_are_not_followed(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = np.arange(5.0)
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["q"] = np.arange(5.0)
        file["link"] = h5py.ExternalLink("other.h5", "secret")
        layout = h5py.VirtualLayout((5,), "f8")
        layout[:] = h5py.VirtualSource("other.h5", "secret", (5,))
        file.create_virtual_dataset("virtual", layout)
    assert open_foreign(tmp_path / "log.h5").columns == ("q",)


def test_arrays_that_are_larger_than_memory_are_not_read(tmp_path: Path) -> None:
    """A small file may say that it holds much: zeros that nobody wrote."""
    import h5py

    with h5py.File(tmp_path / "log.h5", "w") as file:
        file.create_dataset("q", (10**9, 4), "f8", chunks=(1024, 4))
        file.create_dataset("picture", (10**8, 10**8), "f8", chunks=(16, 16))
    table = open_foreign(tmp_path / "log.h5")
    assert table.columns == ("q[0]", "q[1]", "q[2]", "q[3]")
    with pytest.raises(RecordingError, match="more than 1e.08 numbers"):
        table.read(["q[0]"])


def test_a_topic_or_column_that_is_not_there_is_named_with_those_that_are(tmp_path: Path) -> None:
    FORMATS["bag"](tmp_path, some_log())
    with pytest.raises(UnknownName, match="/joint_states, /plate"):
        open_foreign(tmp_path / "log.bag", "/joints")
    table = open_foreign(tmp_path / "log.bag", "/plate")
    assert table.read(["received"])["received"][0] == EPOCH
    with pytest.raises(UnknownName, match="did you mean 'wrench/force/.'"):
        table.read(["wrench/force/w"])


@pytest.mark.parametrize(("name", "package"), [("hdf5", "h5py"), ("bag", "rosbags")])
def test_a_missing_library_says_which_extra_has_it(
    name: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "map.toml").write_text(FORMATS[name](tmp_path, some_log()))
    real = builtins.__import__

    def without(what: str, *args: Any, **kwargs: Any) -> Any:
        if what.partition(".")[0] == package:
            raise ImportError(what)
        return real(what, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(RecordingError, match=rf"{package}.*pip install '.\[import\]'"):
        tb.Recording.from_mapping(tmp_path / "map.toml")


def test_what_is_no_column_is_left_out_of_a_matlab_file(tmp_path: Path) -> None:
    """Words, volumes and tables of logicals beside columns of numbers."""
    content = {
        "q": np.arange(6.0).reshape(3, 2), "note": "by hand", "volume": np.zeros((2, 2, 2)),
        "log": {"t": np.arange(3.0), "who": "me"},
    }  # fmt: skip
    savemat(tmp_path / "log.mat", content)
    table = open_foreign(tmp_path / "log.mat")
    assert not {"note", "volume", "log/who"} & {name.split("[")[0] for name in table.columns}
    assert any(name.startswith("log/t") for name in table.columns)
    assert any(name.startswith("q") for name in table.columns)


@pytest.mark.parametrize("points", [1, 3])
def test_analog_channels_stand_beside_points(points: int, tmp_path: Path) -> None:
    """A frame of C3D has four numbers a point, then its analog channels."""
    rng = np.random.default_rng(0)
    place, force = rng.normal(size=(3, points, 5)), rng.normal(size=(2, 5))
    write_c3d(
        tmp_path / "log.c3d",
        force,
        place,
        ANALOG={"LABELS": ("Fx", "Fy")},
        POINT={"LABELS": tuple(f"m{k}" for k in range(points))},
    )
    table = open_foreign(tmp_path / "log.c3d")
    wanted = {"analog/Fx": force[0], "analog/Fy": force[1]} | {
        f"point/m{k}/{axis}": place["xyz".index(axis), k] for k in range(points) for axis in "xyz"
    }
    for name, values in table.read(wanted).items():
        np.testing.assert_allclose(values, wanted[name], rtol=1e-6)


def test_what_a_c3d_file_says_of_units_names_and_unseen_points(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    place, force = rng.normal(size=(3, 1, 6)), rng.normal(size=(4, 6))
    place[:, 0, 2] = np.nan
    write_c3d(
        tmp_path / "log.c3d",
        force,
        place,
        ANALOG={"LABELS": ("Fx", "Fx", "", "My"), "UNITS": ("N", "N", "", "Nmm")},
        POINT={"LABELS": ("m",), "UNITS": ("mm",)},
    )
    table = open_foreign(tmp_path / "log.c3d")
    assert set(table.columns) == {
        *("analog/time", "point/time", "point/m/x", "point/m/y", "point/m/z"),
        *("analog/Fx", "analog/Fx (1)", "analog/2", "analog/My"),
    }
    units = {"analog/time": "s", "point/time": "s", "analog/Fx": "N", "analog/My": "Nmm"}
    assert table.units == units | {f"point/m/{axis}": "mm" for axis in "xyz"}
    read = table.read(table.columns)
    np.testing.assert_allclose(read["analog/time"], np.arange(6) / 100.0)
    np.testing.assert_allclose(read["analog/Fx (1)"], force[1], rtol=1e-6)
    np.testing.assert_allclose(read["analog/2"], force[2], rtol=1e-6)
    assert np.flatnonzero(np.isnan(read["point/m/y"])).tolist() == [2]
