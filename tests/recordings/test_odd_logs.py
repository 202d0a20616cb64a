"""Logs as programs write them that nobody had in mind: each gives the right numbers, or is said."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.importing.convert import import_recordings
from testbed.importing.guess import guess_mapping
from testbed.importing.import_report import MappingDraft
from testbed.importing.readers import open_foreign_table
from tests.helpers.command import command_line
from tests.helpers.foreign_files import write_c3d
from tests.helpers.refusals import refuses

JOINTS = ("left", "right")
TIME = np.arange(0, 8, 0.01)


def motion(time: Array) -> Array:
    """Two joints, (M, 2) [rad]."""
    return np.stack([np.sin(2 * time), 0.5 * np.cos(3 * time)], axis=1)


def load(time: Array) -> Array:
    """Their torques, (M, 2) [N m]."""
    return np.stack([10 * np.cos(2 * time), 4 * np.sin(3 * time) - 1], axis=1)


def written(
    path: Path, stamps: list[str], values: Array, head: str = "time", sep: str = ","
) -> Path:
    """A table of stamps, positions and torques; nan as nothing."""
    names = [head, "q_left", "q_right", "tau_left", "tau_right"]
    rows = [
        [s, *("" if np.isnan(x) else f"{x:.9g}" for x in row)]
        for s, row in zip(stamps, values, strict=True)
    ]
    path.write_text("\n".join(sep.join(row) for row in [names, *rows]) + "\n")
    return path


def table(time: Array = TIME) -> Array:
    return np.hstack([motion(time), load(time)])


def draft_of(*paths: Path) -> MappingDraft:
    """The guessed mapping, what names do not say filled in."""
    draft = guess_mapping(paths, paths[0].parent, JOINTS)
    for kind, unit in (("position", "rad"), ("torque", "N m")):
        if draft.tables[kind]["unit"] == "":
            draft = draft.with_key(kind, "unit", unit)
    (paths[0].parent / "map.toml").write_text(draft.text)
    return draft


def recorded(*paths: Path) -> tb.Recording:
    draft_of(*paths)
    return tb.import_recording(paths[0].parent / "map.toml")


def is_right(found: tb.Recording, begin: float = 0.0, atol: float = 1e-4) -> None:
    time = begin + np.asarray(found.time)
    np.testing.assert_allclose(found.position, motion(time), atol=atol)
    np.testing.assert_allclose(found.measured("torque"), load(time), atol=30 * atol)


WRITTEN: dict[str, Callable[[datetime], str]] = {
    "ISO": lambda t: t.isoformat(timespec="milliseconds"),
    "with a blank": lambda t: t.isoformat(" ", "milliseconds"),
    "UTC": lambda t: t.isoformat(timespec="milliseconds") + "Z",
    "with a zone": lambda t: t.isoformat(timespec="milliseconds") + "+01:00",
    "of the day": lambda t: f"{t:%H:%M:%S.%f}"[:-3],
    "with a comma": lambda t: f"{t:%H:%M:%S,%f}"[:-3],
    "day first": lambda t: f"{t:%d.%m.%Y %H:%M:%S.%f}"[:-3],
    "month first": lambda t: f"{t:%m/%d/%Y %H:%M:%S.%f}"[:-3],
    "of twelve hours": lambda t: f"{t:%m/%d/%Y %I:%M:%S.%f %p}",
    "days": lambda t: f"{45000 + (t - datetime(2026, 3, 4)) / timedelta(days=1):.11f}",
}
"""How programs write instants."""


@pytest.mark.parametrize("way", WRITTEN)
def test_written_instants_are_times_also_over_midnight_and_show_what_is_missing(
    way: str, tmp_path: Path
) -> None:
    begin = datetime(2026, 3, 4, 23, 59, 57, 500_000)
    kept = np.delete(np.arange(len(TIME)), slice(400, 460))  # .6 s
    stamps = [WRITTEN[way](begin + timedelta(seconds=float(t))) for t in TIME[kept]]
    draft_of(written(tmp_path / "log.csv", stamps, table()[kept], sep=";"))
    first, second = import_recordings(tmp_path / "map.toml")[0]
    is_right(first)
    is_right(second)


@pytest.mark.parametrize("brackets", ["{}", "[{}]", '"({})"'])
def test_a_row_of_units_below_the_names_is_of_the_columns(brackets: str, tmp_path: Path) -> None:
    """After a preamble, and beside what has no unit."""
    text = "\n".join(
        f"{1e3 * t:.3f}\t{k}\t{np.degrees(q):.9f}\t{q:.3f}"
        for k, (t, q) in enumerate(zip(TIME, motion(TIME)[:, 0], strict=True))
    )
    units = "\t".join(brackets.format(unit) for unit in ("ms", "-", "°", "°"))
    (tmp_path / "log.txt").write_text(
        f"Bench\t7\nby Kim\n\nZeit\tcount\tAngle1\tAngle2\n{units}\n\n{text}\n"
    )
    found = open_foreign_table(tmp_path / "log.txt")
    assert found.columns == ("Zeit", "count", "Angle1", "Angle2")
    assert (found.unit("Zeit"), found.unit("Angle2")) == ("ms", "°")
    draft = guess_mapping([tmp_path / "log.txt"], tmp_path)
    assert draft.tables["position"]["unit"] == "deg"
    assert (draft.tables["sources.log"]["time"], draft.tables[""]["rate"]) == ("Zeit", 100)


def test_samples_without_numbers_are_bridged_and_counted_and_longer_ones_are_cut_out(
    tmp_path: Path,
) -> None:
    """Whole rows, single cells, words for nothing; of torques logged at half the rate, too."""
    rng = np.random.default_rng(0)
    stamps = [f"{t:.3f}" for t in TIME]
    whole, cells, half = table(), table(), table()
    whole[1 + rng.permutation(len(TIME) - 2)[:8]] = np.nan
    cells[1:-1][rng.random((len(TIME) - 2, 4)) < 0.005] = np.nan
    half[1::2, 2:] = np.nan
    for values in (whole, cells, half):
        path = written(tmp_path / "log.csv", stamps, values)
        path.write_text(path.read_text().replace(",,", ",NA,").replace(",,", ",null,"))
        found = recorded(path)
        is_right(found, atol=2e-4)
        lost = np.isnan(values).any(axis=1).sum()
        text = " ".join(each.text for each in found.metadata.diagnostics)
        assert (f"({lost} samples)" in text) == (values is whole)
        assert bool(text) == (values is not half)
    whole[300:340] = np.nan
    draft_of(written(tmp_path / "log.csv", stamps, whole))
    parts, said = import_recordings(tmp_path / "map.toml")
    assert [each.code for each in said] == ["import.cut"]
    is_right(parts[0], atol=2e-4)
    is_right(parts[1], atol=2e-4)
    for words, code in (((), 0), ((), 2), (("--force",), 0)):
        words = ("import", "map.toml", "--out", "made.parquet", *words)
        assert command_line(*words, cwd=tmp_path).returncode == code
    assert [path.name for path in tmp_path.glob("*.parquet")] == ["made.parquet"]
    assert len(tb.Recording.load(tmp_path / "made.parquet").segments) == 2


def test_a_signal_that_begins_late_shortens_the_recording_and_an_empty_one_is_left_out(
    tmp_path: Path,
) -> None:
    late, stamps = table(), [f"{t:.3f}" for t in TIME]
    late[:200, 2:] = np.nan
    found = recorded(written(tmp_path / "log.csv", stamps, late))
    is_right(found, 2.0)
    assert [each.code for each in found.metadata.diagnostics] == ["import.shorter"]
    path = written(tmp_path / "log.csv", stamps, table())
    lines = path.read_text().splitlines()
    rows = (f"{line},nan," for line in lines[1:])
    path.write_text("\n".join([f"{lines[0]},qd_left,qd_right", *rows]))
    assert "velocity" not in draft_of(path).content
    is_right(recorded(path))


@pytest.mark.parametrize(("tick", "rate"), [(1e-3, 2000), (16e-3, 100), (1.0, 100)])
def test_a_clock_that_is_coarser_than_the_samples_is_made_steady(
    tick: float, rate: float, tmp_path: Path
) -> None:
    """By what each sample is, not by when the clock was read; without one it is refused."""
    time = np.arange(0, 12, 1 / rate)
    stamps = [f"{tick * np.floor((t + 0.3) / tick + 1e-6):.3f}" for t in time]
    path = written(tmp_path / "log.csv", stamps, table(time))
    draft = draft_of(path)
    assert draft.tables["sources.log"]["steady"] is True
    assert draft.tables[""]["rate"] == rate
    found = tb.import_recording(tmp_path / "map.toml")
    assert found.samples == pytest.approx(len(time), abs=2 + tick * rate)
    is_right(found, atol=5e-3)
    (tmp_path / "map.toml").write_text(draft.with_key("sources.log", "steady", None).text)
    with refuses(RecordingError, "sources.log"):
        tb.import_recording(tmp_path / "map.toml")
    gone = np.delete(np.arange(len(time)), slice(len(time) // 2, len(time) // 2 + rate))
    written(path, [stamps[k] for k in gone], table(time)[gone])
    # no steady device leaves out a second
    assert "steady" not in draft_of(path).tables["sources.log"]


@pytest.mark.parametrize("ending", ["npz", "mat"])
def test_arrays_of_two_rates_are_sources_with_clocks_of_their_own(
    ending: str, tmp_path: Path
) -> None:
    """What is no signal is no source; of which length times are missing is said."""
    fast = np.arange(0, 8, 2e-3)
    arrays: dict[str, Any] = {"q": motion(fast), "time_q": fast, "gains": np.ones(5)}
    arrays |= {"tau": load(TIME), "t_tau": TIME}
    path = tmp_path / f"log.{ending}"

    def write() -> None:
        savemat(path, arrays) if ending == "mat" else np.savez(path, **arrays)

    write()
    found = recorded(path)
    is_right(found)
    assert found.rate == pytest.approx(500)
    del arrays["t_tau"]
    write()
    draft = draft_of(path)
    source = f"sources.{draft.tables['torque']['source']}"
    assert draft.tables[source]["rate"] == 0
    assert str(len(TIME)) in draft.key_comments[source, "rate"]


def test_loads_with_a_sign_bit_are_decoded_or_refused_with_the_key(tmp_path: Path) -> None:
    """Bit 10 of servos' loads, bit 15 of currents; torques without one stay."""
    stamps = [f"{t:.3f}" for t in TIME]
    for bit in (1024, 2048, 32768):
        size = np.round(load(TIME) * bit / 12)
        coded = np.where(size < 0, bit - size, size)
        path = written(tmp_path / "log.csv", stamps, np.hstack([motion(TIME), coded]))
        draft = draft_of(path).with_key("torque", "gain", 12 / bit)
        (tmp_path / "map.toml").write_text(draft.text)
        assert draft.tables["torque"]["sign_bit"] == bit
        is_right(tb.import_recording(tmp_path / "map.toml"), atol=1e-3)
        (tmp_path / "map.toml").write_text(draft.with_key("torque", "sign_bit", None).text)
        with refuses(RecordingError, "torque", f"sign_bit = {bit}"):
            tb.import_recording(tmp_path / "map.toml")
    plain = np.hstack([motion(TIME), np.round(100 * load(TIME)) + 1024])
    assert "sign_bit" not in draft_of(written(path, stamps, plain)).tables["torque"]


CENTRE, A, B, DEEP = np.array([0.4, -0.1, 0.02]), 0.12, 0.2, 0.05
"""Of the plate's top, and of a type-3 plate: places of its sensors about the centre [m]."""
EIGHT = np.array([
    [1, 1, 0, 0, 0, 0, 0, 0], [0, 0, 1, 1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 1, 1, 1],
    [0, 0, 0, 0, B, B, -B, -B], [0, 0, 0, 0, -A, A, A, -A], [-B, B, A, -A, 0, 0, 0, 0],
])  # fmt: skip
"""Force and moment by eight channels of a type-3 plate: x12 x34 y14 y23 z1 z2 z3 z4."""


@pytest.mark.parametrize("kind", [2, 3, 4])
@pytest.mark.parametrize("unit", ["mm", "m"])
def test_plates_that_a_c3d_file_describes_act_where_it_says(
    kind: int, unit: str, tmp_path: Path
) -> None:
    """Forces at known points of the top have moments about the laboratory's origin."""
    rng = np.random.default_rng(kind)
    scale = {"mm": 1e-3, "m": 1.0}[unit]
    force = 5 * rng.normal(size=(400, 3)) + [0, 0, -200]  # by the robot, downwards
    at = np.column_stack([0.1 * rng.normal(size=(400, 2)), np.zeros(400)])  # of the centre, on top
    turn = Rotation.from_euler("z", 20, degrees=True)
    own, place = turn.inv().apply(force) * [1, -1, -1], at * [1, -1, -1]  # z of the sensor is down
    middle = np.array([0.0 if kind == 3 else -0.01, 0.0, DEEP])
    wrench = np.hstack([own, np.cross(place - middle, own) / (1.0 if kind == 3 else scale)]).T
    channels, units = wrench, ["N"] * 3 + [{"mm": "Nmm", "m": "Nm"}[unit]] * 3
    said: dict[str, Any] = {}
    if kind == 3:
        channels, units = np.linalg.pinv(EIGHT) @ wrench, ["N"] * 8
    elif kind == 4:
        gains = np.diag([2.0, 2, 5, 1, 1, 3]) + 0.01 * rng.normal(size=(6, 6))
        channels, units = np.linalg.solve(gains, wrench), ["V"] * 6
        said["CAL_MATRIX"] = gains[..., None]
    corners = np.array([(1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0)]) * [0.3, -0.2, 1.0]
    origin = np.array([A, B, -DEEP] if kind == 3 else [0.01, 0.0, -DEEP])
    said |= {
        "USED": [1], "TYPE": [kind], "CHANNEL": np.arange(1, len(channels) + 1)[:, None],
        "CORNERS": (turn.apply(corners) + CENTRE).T[..., None] / scale,
        "ORIGIN": origin[:, None] / scale,
    }  # fmt: skip
    labels = tuple(f"c{k}" for k in range(len(channels)))
    write_c3d(
        tmp_path / "plate.c3d", channels, np.zeros((3, 0, 400)),
        ANALOG={"LABELS": labels, "UNITS": tuple(units)}, POINT={"UNITS": (unit,)},
        FORCE_PLATFORM=said,
    )  # fmt: skip
    time = np.arange(400) / 100
    robot = written(tmp_path / "robot.csv", [f"{t:.3f}" for t in time], table(time))
    draft = draft_of(robot, tmp_path / "plate.c3d")
    assert draft.tables["sources.plate"]["time"] == "analog/time"
    found = tb.import_recording(tmp_path / "map.toml").measured("wrench")
    wanted = -np.hstack([force, np.cross(turn.apply(at) + CENTRE, force)])
    np.testing.assert_allclose(found, wanted[: len(found)], atol=2e-3)


def test_joints_of_two_nodes_are_one_signal_and_rows_without_times_are_none(tmp_path: Path) -> None:
    """Each node's rows hold its own joints only; where one was silent nothing is made up."""
    late = TIME + 0.004
    rows = np.full((2 * len(TIME), 4), np.nan)
    rows[::2, [0, 2]] = table(TIME)[:, [0, 2]]
    rows[1::2, [1, 3]] = table(late)[:, [1, 3]]
    stamps = [f"{t:.3f}" for pair in zip(TIME, late, strict=True) for t in pair]
    path = written(tmp_path / "log.csv", stamps, rows)
    found = recorded(path)
    assert found.rate == pytest.approx(100)
    is_right(found, 0.01 if found.position[0, 0] > 0.01 else 0.0, atol=1e-3)
    rows[601:701:2] = np.nan
    with refuses(RecordingError, "sources.log"):
        recorded(written(path, stamps, rows))
    empty = table()
    empty[100:103] = np.nan
    path = written(tmp_path / "log.csv", [f"{t:.3f}" for t in TIME], empty)
    path.write_text(path.read_text().replace("\n1.010,", "\n,").replace("\n1.020,", "\nnan,"))
    is_right(recorded(path), atol=2e-4)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_text_is_read_in_the_encodings_that_programs_write(encoding: str, tmp_path: Path) -> None:
    """Spreadsheets' "Unicode text" is UTF-16; a sign of degrees tells the others apart."""
    path = tmp_path / "log.csv"
    path.write_bytes("t,q1 [°]\n0,1.5\n1,2.5\n2,3.5\n".encode(encoding))
    table = open_foreign_table(path)
    assert table.column_values(["q1 [°]"])["q1 [°]"].tolist() == [1.5, 2.5, 3.5]
