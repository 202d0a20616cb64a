"""Each thing that a mapping may say wrongly is answered in words about that thing."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError, UnknownName
from testbed.recordings.importing.guess import guessed
from testbed.recordings.importing.readers import open_foreign, reader_of
from tests.helpers.foreign_files import FORMATS, csv, npz, some_log

WRENCH = '[wrench]\nsource = "log"\nunits = ["N", "N m"]\nsense = "on_robot"\n'


def without(text: str, table: str) -> str:
    """A mapping without one of its tables."""
    head, _, rest = text.partition(f"[{table}]")
    _, bracket, others = rest.partition("\n[")
    return head + bracket.lstrip("\n") + others


def added(line: str, table: str = "sources.log") -> Callable[[str], str]:
    return lambda text: text.replace(f"[{table}]\n", f"[{table}]\n{line}\n", 1)


def first(line: str) -> Callable[[str], str]:
    return lambda text: f"{line}\n{text}"


def last(lines: str) -> Callable[[str], str]:
    return lambda text: f"{text}\n{lines}\n"


QUATERNION = json.dumps([f"w[{k}]" for k in range(4)])
BASE = f'[base]\nsource = "log"\nposition = ["q[0]", "q[1]", "w[0]"]\nquaternion = {QUATERNION}'
CHANNELS = json.dumps([f"w[{k}]" for k in range(6)])
PLATE = WRENCH.replace("[wrench]", "[plates.left]") + f"columns = {CHANNELS}"

WRONG: dict[str, tuple[Callable[[str], str], str]] = {
    "nothing measured": (
        lambda text: without(without(text, "torque"), "wrench"),
        r"a recording has a \[torque\] or a \[wrench\] or both",
    ),
    "wrench and plates": (last(PLATE), r"say \[wrench\], or all plates under \[plates\], not both"),
    "joint without a name": (
        lambda text: text.replace('["j1", "j2"]', '["j1", "j\\u0007"]'),
        "joints.*it is no name",
    ),
    "stop before start": (first("start = 2.0\nstop = 1.0"), "stop comes after start"),
    "stop at start": (first("start = 1.0\nstop = 1.0"), "stop comes after start"),
    "too many motors": (last("[gear]\nratio = [2, 2, 2]"), "gear: 3 motors, 2 joints"),
    "two gears": (
        last("[gear]\nratio = [2, 2]\nmatrix = [[1, 0], [0, 1]]"),
        "a gear has a `ratio` or a `matrix`, one of them",
    ),
    "no gear": (last("[gear]"), "a gear has a `ratio` or a `matrix`, one of them"),
    "gear not square": (last("[gear]\nmatrix = [[1, 0], [0]]"), "square and can be inverted"),
    "gear of rank one": (last("[gear]\nmatrix = [[1, 1], [1, 1]]"), "square and can be inverted"),
    "base in radians": (last(f'{BASE}\nunit = "rad"'), "base.unit: 'rad' is no length"),
    "base of no length": (
        last(f'{BASE}\nunit = "m"'),
        "base.quaternion: its length is .* w, x, y, z",
    ),
    "matrix too wide": (
        added("matrix = [[1, 0, 0], [0, 1, 0]]", "position"),
        "position.matrix: a row has as many numbers as there are columns",
    ),
    "five channels": (
        lambda text: text.replace(', "w[5]"', ""),
        "wrench.columns: 5 columns, 6 wanted, or a matrix of six rows",
    ),
    "short matrix of the plate": (
        added(f"matrix = {[[0.0] * 6] * 5}", "wrench"),
        "wrench.matrix: six rows of 6 numbers are wanted",
    ),
    "narrow matrix of the plate": (
        added(f"matrix = {[[0.0] * 5] * 6}", "wrench"),
        "wrench.matrix: six rows of 6 numbers are wanted",
    ),
    "unknown key of the base": (
        last(f'{BASE}\nunit = "m"\ncolumns = []'),
        r"unknown key in \[base\] 'columns' \(known: source, position, unit, quaternion, delay\)",
    ),
    "misspelled key of the plate": (
        added("plaec = 1", "wrench"),
        r"unknown key in \[wrench\] 'plaec'; did you mean 'place'",
    ),
    "misspelled key of a source": (
        added("timeunit = 's'"),
        r"unknown key in \[sources.log\] 'timeunit'; did you mean 'time_unit'",
    ),
    "steady without times": (
        lambda text: text.replace('time = "t"\ntime_unit = "s"', "rate = 100\nsteady = true"),
        "`time_unit` and `steady` are about a column `time`",
    ),
    "unit without times": (
        lambda text: text.replace('time = "t"', "rate = 100"),
        "`time_unit` and `steady` are about a column `time`",
    ),
    "no file name": (
        lambda text: text.replace('"log.npz"', '"log\\u0000.npz"'),
        "file is not a file name",
    ),
    "gain of positions": (added("gain = 2.0", "position"), "position.gain: gains are for torques"),
    "a source of nothing": (
        last('[sources.more]\nfile = "log.npz"\nrate = 100'),
        "sources.more: no signal is of it",
    ),
    "a topic of no bag": (added('topic = "/joints"'), "`topic` is for ROS bags"),
    "another kind of file": (
        lambda text: text.replace('"log.npz"', '"map.toml"'),
        "unknown format '.toml'",
    ),
    "a folder": (lambda text: text.replace('"log.npz"', '"."'), "is a folder, and no ROS 2 bag"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_mapping_is_answered_in_words_about_it(name: str, tmp_path: Path) -> None:
    change, said = WRONG[name]
    right = npz(tmp_path, some_log())
    wrong = change(right)
    assert wrong != right
    (tmp_path / "map.toml").write_text(wrong)
    with pytest.raises(tb.TestbedError, match=said) as error:
        tb.Recording.from_mapping(tmp_path / "map.toml")
    assert "\n" not in str(error.value)


def test_times_that_are_no_numbers_are_found(tmp_path: Path) -> None:
    log = some_log()
    log.t[7] = np.nan
    (tmp_path / "map.toml").write_text(npz(tmp_path, log))
    with pytest.raises(RecordingError, match="sources.log: 't' is no number at sample 7"):
        tb.Recording.from_mapping(tmp_path / "map.toml")


def test_four_samples_are_needed(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(csv(tmp_path, some_log(3)))
    with pytest.raises(RecordingError, match="sources.log: 3 samples, which is no recording"):
        tb.Recording.from_mapping(tmp_path / "map.toml")


@pytest.mark.parametrize("times", [1e-9, 1e12])
def test_sampling_times_of_no_instrument_are_a_wrong_unit(times: float, tmp_path: Path) -> None:
    log = some_log()
    log.t[:] *= times
    (tmp_path / "map.toml").write_text(npz(tmp_path, log))
    with pytest.raises(RecordingError, match=r"s from sample to sample is no .*`time_unit`"):
        tb.Recording.from_mapping(tmp_path / "map.toml")


def test_columns_of_different_lengths_are_listed(tmp_path: Path) -> None:
    log = some_log()
    text = npz(tmp_path, log)
    np.savez(tmp_path / "log.npz", **{**vars(log), "tau": log.tau[:-2]})
    (tmp_path / "map.toml").write_text(text)
    said = r"sources.log: columns of different lengths: .*'q\[0\]' 60.*'tau\[0\]' 58"
    with pytest.raises(RecordingError, match=said):
        tb.Recording.from_mapping(tmp_path / "map.toml")


def test_a_bag_needs_its_topic(tmp_path: Path) -> None:
    text = FORMATS["mcap"](tmp_path, some_log())
    lines = [line for line in text.splitlines() if not line.startswith("topic")]
    (tmp_path / "map.toml").write_text("\n".join(lines))
    with pytest.raises(RecordingError, match="say `topic`"):
        tb.Recording.from_mapping(tmp_path / "map.toml")


def test_an_array_alone_is_a_file_of_columns(tmp_path: Path) -> None:
    values = np.random.default_rng(1).normal(size=(20, 3))
    np.save(tmp_path / "log.npy", values)
    table = open_foreign(tmp_path / "log.npy")
    found = table.read(["array[0]", "array[2]"])
    np.testing.assert_array_equal(found["array[0]"], values[:, 0])
    np.testing.assert_array_equal(found["array[2]"], values[:, 2])
    with pytest.raises(UnknownName, match=r"array\[3\]"):
        table.read(["array[3]"])


def test_text_of_an_old_code_page_is_read(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes("t,größe\n0,1\n1,2.5\n".encode("latin-1"))
    table = open_foreign(tmp_path / "log.csv")
    np.testing.assert_array_equal(table.read(["größe"])["größe"], [1, 2.5])


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.csv", b"", "there is no line of numbers in it"),
        ("a.csv", b"words\nand more words\n", "there is no line of numbers in it"),
        ("a.csv", b"1,2\n\0\n", "it is no text"),
        ("a.c3d", b"\2\x50" + bytes(100), "no C3D file"),
        ("a.c3d", b"\2\x51" + bytes(2000), "no C3D file"),
        ("a.c3d", b"\2\x50" + bytes(513) + b"\x55" + bytes(2000), "an old processor's kind"),
    ],
)
def test_files_that_hold_no_log_are_refused(
    name: str, data: bytes, said: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(RecordingError, match=said) as error:
        open_foreign(tmp_path / name)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("separator", "point"), [(",", "."), (";", ","), ("\t", ".")])
def test_of_a_field_that_is_no_number_line_and_column_are_named(
    separator: str, point: str, tmp_path: Path
) -> None:
    """An empty one is nan; comments and a preamble count as lines."""
    rng = np.random.default_rng(3)
    numbers = rng.normal(size=(30, 4))
    for _ in range(10):
        row, column = rng.integers(1, 30), rng.integers(0, 4)
        rows = [[f"{x:.6f}".replace(".", point) for x in each] for each in numbers]
        for field in ("", "off"):
            rows[row][column] = field
            lines = ["of a logger", separator.join("abcd"), *map(separator.join, rows)]
            lines.insert(10, "# a comment")
            (tmp_path / "log.csv").write_text("\n".join(lines))
            if field:
                number = lines.index(separator.join(rows[row])) + 1
                with pytest.raises(RecordingError, match=rf"line {number}: '{'abcd'[column]}' is"):
                    open_foreign(tmp_path / "log.csv")
            else:
                found = open_foreign(tmp_path / "log.csv").read(list("abcd"))
                wanted = numbers.copy()
                wanted[row, column] = np.nan
                read = np.stack([found[name] for name in "abcd"], axis=1)
                np.testing.assert_allclose(read, wanted, rtol=0, atol=1e-6)


def test_what_is_no_log_has_no_guess(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="there is no file"):
        guessed([tmp_path / "none.csv"], tmp_path)
    np.savez(tmp_path / "empty.npz", text=np.array(["a", "b"]))
    with pytest.raises(RecordingError, match="no columns of numbers in"):
        guessed([tmp_path / "empty.npz"], tmp_path)


def test_endings_are_of_formats(tmp_path: Path) -> None:
    csv(tmp_path, some_log())
    assert reader_of(tmp_path / "log.csv") == "delimited_text"
    for name, said in (("log.xls", r"\.xls"), ("log.npz.gz", r"\.npz\.gz"), ("log", "log")):
        (tmp_path / name).write_bytes(b"1")
        with pytest.raises(UnknownName, match=f"format '{said}'"):
            reader_of(tmp_path / name)
    with pytest.raises(RecordingError, match="is a folder, and no ROS 2 bag"):
        reader_of(tmp_path)
