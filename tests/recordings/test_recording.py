"""Recordings come back as they were saved, whole or in parts, and say what is wrong with them."""

from __future__ import annotations

import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.errors import RecordingError
from testbed.recordings.checks import check_times, checked_metadata
from testbed.recordings.columns import members_of, unit_of
from testbed.recordings.coupled_gear import LONGEST, coupled_shafts, with_gear
from testbed.recordings.formats import parquet
from testbed.recordings.geometry import TOLERANCE, check_robot, geometry
from testbed.recordings.joined import Joined
from testbed.recordings.measured_base import (
    NAMES,
    MeasuredBase,
    on_its_base,
    with_base_joints,
)
from testbed.recordings.recording import Recording
from testbed.recordings.source import gathered, open_source
from testbed.recordings.stored import write_parts
from testbed.robot.free_base import on_free_base
from tests.helpers.ideal import ideal
from tests.helpers.measured import measured
from tests.helpers.refusals import refuses
from tests.helpers.riding import riding
from tests.helpers.robots import random_robot
from tests.helpers.runs import robot, without
from tests.helpers.strategies import few, trees

SIZE = 130
"""Samples of a row group."""


@pytest.fixture(scope="module")
def tree() -> tb.Tree:
    """With joints of both kinds."""
    return random_robot(np.random.default_rng(2), 3).tree()


@pytest.fixture(scope="module")
def whole(tree: tb.Tree) -> Recording:
    made = ideal(tree, duration=10.0, rate=100.0)
    facts = {"robot": "r", "geometry": geometry(tree)}
    return replace(made, tare=np.arange(6.0), facts=facts)


@pytest.fixture(scope="module")
def path(whole: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """In row groups; the last is shorter."""
    path = tmp_path_factory.mktemp("stored") / "r.parquet"
    write_parts(cut(whole), path)
    assert pq.ParquetFile(path).metadata.num_row_groups == -(-whole.samples // SIZE)
    return path


def cut(whole: Recording) -> list[Recording]:
    starts = range(0, whole.samples, SIZE)
    return [whole.part(first, min(first + SIZE, whole.samples)) for first in starts]


def same(one: Recording, other: Recording) -> None:
    assert (one.names, one.facts, one.signals) == (other.names, other.facts, other.signals)
    assert one.columns().keys() == other.columns().keys()
    for name, values in one.columns().items():
        np.testing.assert_array_equal(values, other.columns()[name])
    np.testing.assert_array_equal(one.tare, other.tare)


@few(8)
@given(tree=trees((1, 4)), senses=st.booleans(), lacks=st.sampled_from(["torque", "wrench", ""]))
def test_a_recording_comes_back_bit_for_bit_with_units(
    tree: tb.Tree, senses: bool, lacks: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Truth included; whatever its ending; what was not measured is said when asked for."""
    saved = ideal(tree, duration=1.0, rate=50.0)
    if not senses:
        saved = replace(saved, velocity=None, acceleration=None)
    saved = replace(without(saved, lacks) if lacks else saved, facts={"geometry": geometry(tree)})
    path = tmp_path_factory.mktemp("r") / "r.v2"
    saved.save(path.with_suffix(".parquet"))
    path.with_suffix(".parquet").rename(path)
    loaded = Recording.load(path)
    same(loaded, saved)
    for name, values in saved.true_columns().items():
        np.testing.assert_array_equal(loaded.true_columns()[name], values)
    assert loaded.senses_kinematics == senses
    found = {field.name: field.metadata[b"unit"].decode() for field in pq.read_schema(path)}
    turns = {joint.name: joint.revolute for joint in tree.joints}
    for name, said in found.items():
        signal, _, member = name.removeprefix("truth/").partition("/")
        angle = ("rad", "N m") if turns.get(member, True) else ("m", "N")
        wanted = {"time": "s", "position": angle[0], "velocity": f"{angle[0]}/s",
                  "acceleration": f"{angle[0]}/s^2", "torque": angle[1], "friction": angle[1],
                  "wrench": "N" if member.startswith("F") else "N m"}[signal]  # fmt: skip
        assert said == wanted, name
    if lacks:
        with refuses(RecordingError, lacks):
            loaded.measured(lacks)
    base = [unit_of(f"base/{name}", {}) for name in members_of("base", ("waist",))]
    assert base == ["m"] * 3 + ["1"] * 4


def test_parts_of_a_file_are_those_of_the_whole_in_any_order_and_size(
    whole: Recording, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forward, across row groups, back, the same again, none; a reader may hold so much at once."""
    stored, n = tb.StoredRecording(path), whole.samples
    assert (stored.names, stored.samples, stored.signals) == (whole.names, n, whole.signals)
    assert stored.rate == pytest.approx(100.0, rel=1e-12)
    spans = [(0, 10), (10, 400), (390, 700), (129, 131), (130, 260), (130, 260), (5, 6), (0, n)]
    for first, last in [*spans, (n - 1, n), (0, 0), (n, n)]:
        part = whole.part(first, last)
        same(stored.part(first, last), part)
        assert part.truth is None
        assert np.shares_memory(part.position, whole.position) or not part.samples
    for at_once in (7, SIZE, 10**6):
        monkeypatch.setattr("testbed.recordings.recording.AT_ONCE", at_once)
        same(Recording.load(path), whole)
    found = gathered(iter(cut(whole)))
    same(found, whole)
    assert not found.position.flags.owndata  # it lies in a file, not in memory
    for named in (path, str(path), cut(whole), whole, stored):
        same(open_source(named).part(0, n), whole.part(0, n))
    column = pq.ParquetFile(path).metadata.row_group(0).column(1)
    assert ("BYTE_STREAM_SPLIT" in column.encodings, column.compression) == (True, "ZSTD")
    one, two, *_ = cut(whole)
    for other in (replace(two, names=("x", "y", "z")), replace(two, torque=None)):
        for make in (gathered, lambda parts: write_parts(parts, path.with_name("other.parquet"))):
            with refuses(RecordingError, "channels"):
                make([one, other])
    monkeypatch.setattr(parquet, "MOST_METADATA", 20)
    with refuses(RecordingError, path.name):
        tb.StoredRecording(path)


def test_a_save_that_fails_or_would_overwrite_a_strangers_file_changes_nothing(
    whole: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "r.parquet"
    whole.save(path)
    before = path.read_bytes()
    with pytest.raises(TypeError):
        replace(whole, facts={"what": object()}).save(path)
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["r.parquet"]
    for content in (b"time,position\n0,1\n", b"", b"PAR"):
        (tmp_path / "notes.csv").write_bytes(content)
        with refuses(RecordingError, "notes.csv"):
            whole.save(tmp_path / "notes.csv")
        assert (tmp_path / "notes.csv").read_bytes() == content


def test_columns_are_found_by_name_and_another_robots_are_refused(
    whole: Recording, path: Path, tree: tb.Tree
) -> None:
    """Whatever their order in the file; a kind, a parent, an axis or a place tells."""
    table = pq.read_table(path)
    backwards = table.select(table.column_names[::-1])
    pq.write_table(backwards, path.with_name("backwards.parquet"))
    again = Recording.load(path.with_name("backwards.parquet"))
    assert again.names == tuple(reversed(whole.names))
    same(again.ordered(tree), whole)
    check_robot(replace(whole, facts={}), tree)
    first = tree.joints[0]
    for what, value, culprit in (
        ("offset", [x + 0.5 * TOLERANCE for x in first.offset.tolist()], ""),
        ("offset", [9.0, 0.0, 0.0], "[9.0, 0.0, 0.0]"),
        ("kind", "prismatic" if first.revolute else "revolute", "kind"),
        ("parent", "elsewhere", "elsewhere"),
        ("axis", [0.6, 0.8, 0.0], "[0.6, 0.8, 0.0]"),
        ("axis", [1.0, 0.0], "[1.0, 0.0]"),
    ):
        said = json.loads(json.dumps(geometry(tree)))
        said[first.name][what] = value
        with refuses(RecordingError, f"'{first.name}'", culprit) if culprit else nullcontext():
            check_robot(replace(whole, facts={"geometry": said}), tree)
    with refuses(RecordingError, *whole.names):
        check_robot(whole, robot("puma"))


def rewritten(path: Path, column: str, values: Any) -> Path:
    """The same file with another column, or without it, or with other metadata."""
    table = pq.read_table(path)
    if column == "metadata":
        text = values if isinstance(values, str) else json.dumps(values)
        table = table.replace_schema_metadata({"testbed": text})
    elif values is None:
        table = table.drop_columns([column])
    else:
        table = table.set_column(table.schema.get_field_index(column), column, values)
    pq.write_table(table, path.with_name("other.parquet"))
    return path.with_name("other.parquet")


def test_channels_that_are_no_measurement_are_named_with_their_place(
    whole: Recording, path: Path
) -> None:
    """Missing, doubled, of texts or dates, infinite, unevenly sampled, in another unit of time."""
    time, force = whole.time, whole.measured("wrench")[:, 2]
    late, still = np.where(time > 2, time + 0.005, time), np.array(time)
    still[300] = time[299]
    cases: list[tuple[str, Any, tuple[str, ...]]] = [
        ("torque/j2", None, ("'torque/j2'",)),
        ("time", None, ("'time'",)),
        *(("wrench/Fz", pa.array(np.where(time == 7, bad, force)),
           ("'wrench/Fz'", "sample 700", "7 s")) for bad in (np.nan, np.inf, -1e12)),
        *(("wrench/Fz", pa.array([each] * whole.samples), ("'wrench/Fz'",))
          for each in ("a", None, True)),
        ("time", pa.array(range(whole.samples), pa.timestamp("us")), ("'time'",)),
        ("time", pa.array(late), ("0.015 s", "sample 200")),
        ("time", pa.array(still), ("sample 299",)),
        *(("time", pa.array(time * scale), ()) for scale in (1e-12, 1e300)),
    ]  # fmt: skip
    for column, values, culprits in cases:
        with refuses(RecordingError, "other.parquet", *culprits):
            Recording.load(rewritten(path, column, values))
    columns = {n: v for n, v in whole.columns().items() if not n.startswith("position/")}
    with refuses(RecordingError, "'position/JOINT'"):
        Recording.from_columns(columns, {}, "r")
    single = rewritten(path, "wrench/Fz", pa.array(force.astype(np.float32)))
    np.testing.assert_allclose(Recording.load(single).measured("wrench")[:, 2], force, rtol=1e-6)
    table = pq.read_table(path)
    pq.write_table(table.append_column("time", table["time"]), path.with_name("twice.parquet"))
    with refuses(RecordingError, "'time'"):
        Recording.load(path.with_name("twice.parquet"))
    for count in (0, 1):
        whole.part(0, count).save(path.with_name("short.parquet"))
        assert tb.StoredRecording(path.with_name("short.parquet")).rate == 0.0
        with refuses(RecordingError, f"{count} sample"):
            Recording.load(path.with_name("short.parquet"))
    for share in (0.009, -0.009):  # steps may differ by a hundredth
        check_times(np.append(0.0, 1 + share + np.arange(9.0)), "r", 1.0)
        with refuses(RecordingError, "sample 1000"):
            check_times(np.append(0.0, 1 + 1.2 * share + np.arange(9.0)), "r", 1.0, first=1000)


def test_damaged_files_and_metadata_are_refused_in_one_line(path: Path, tmp_path: Path) -> None:
    for content in (b"", b"PAR1 truncated"):
        (tmp_path / "bad.parquet").write_bytes(content)
        with refuses(RecordingError, "bad.parquet"):
            Recording.load(tmp_path / "bad.parquet")
    for metadata in (
        [1, 2], {"format": "testbed recording 99"}, {"facts": [1]}, {"tare": [1, 2]},
        {"tare": ["a"] * 6}, '{"tare": [NaN, 0, 0, 0, 0, 0]}', {"facts": {"warnings": [3]}},
        {"facts": {"gravity": ["down", 0, 0]}}, {"facts": {"geometry": {"j1": 3}}},
        "[" * 100_000 + "]" * 100_000, "{", '"\\ud800',
    ):  # fmt: skip
        other = rewritten(path, "metadata", metadata)
        for read in (Recording.load, tb.StoredRecording):
            with refuses(RecordingError, "other.parquet"):
                read(other)
    joint: list[tuple[str, Any]] = [
        ("kind", "ball"), ("parent", 3), ("axis", [1, 0]), ("axis", [1, 0, 1e12]),
        ("offset", [1, 0, 0, 0]), ("rotation", [[1, 0, 0], [0, 1], 3]),
    ]  # fmt: skip
    for key, value in joint:
        said = {"facts": {"geometry": {"fine": {"axis": [1, 0, 0]}, "elbow": {key: value}}}}
        with refuses(ValueError, "'elbow'", key):
            checked_metadata(said)
    facts = {"own": {"deep": [1]}}
    tare = (1.0, 2.0, 3.0, 4.0, 5.0, 6.5)
    assert checked_metadata({"tare": list(tare), "facts": facts}) == (tare, facts)
    (tmp_path / "r.doc").write_text("time\n")
    with refuses(RecordingError, "'.doc'", ".parquet"):
        Recording.load(tmp_path / "r.doc")
    for nothing in (tmp_path, tmp_path / "none.parquet"):
        with refuses(RecordingError, nothing.name):
            Recording.load(nothing)


def test_recordings_as_one_have_what_all_have_and_the_first_ones_tare() -> None:
    tree = robot("puma")
    parts = [measured(tree, seed, duration=1.0) for seed in (1, 2)]
    shift = np.arange(6.0)
    moved = replace(
        parts[1], tare=np.asarray(parts[1].tare) + shift, wrench=parts[1].measured("wrench") + shift
    )
    plain, both = Joined(parts), Joined([parts[0], without(moved, "torque")])
    assert "torque" not in both.signals
    for first, last in plain.segments:
        part = both.part(first, last)
        assert part.torque is None
        wrench = plain.part(first, last).measured("wrench")
        np.testing.assert_allclose(part.measured("wrench"), wrench, atol=1e-9)


def test_a_base_that_was_measured_is_six_joints_more_in_memory_and_in_a_file(
    tmp_path: Path,
) -> None:
    free, recording = riding(11)
    recording.save(tmp_path / "r.parquet")
    whole = with_base_joints(recording)
    source = on_its_base(open_source(tmp_path / "r.parquet"), free)
    assert isinstance(source, MeasuredBase)
    assert source.names == whole.names == (*NAMES, *recording.names)
    for first, last in ((0, 100), (100, recording.samples)):
        part = source.part(first, last)
        assert (part.base, part.torque) == (None, None)
        for name, values in part.columns().items():
            np.testing.assert_array_equal(values, whole.columns()[name][first:last])
    assert on_its_base(whole, free) is whole
    fixed = ideal(robot("puma"), duration=1.0)
    assert on_its_base(fixed, robot("puma")) is fixed
    with refuses(RecordingError, "base/x"):
        MeasuredBase(fixed)
    with refuses(RecordingError, "base"):
        on_its_base(fixed, on_free_base(robot("puma")))


def test_shafts_of_coupled_gears_are_named_after_their_own_joint_and_nothing_is_trusted() -> None:
    joints = ["waist", "wrist", "flange"]

    def shafts(matrix: object, names: object = joints) -> Any:
        return coupled_shafts({"mapping": {"gear": {"matrix": matrix}, "joints": names}})

    found = shafts([[40, 0, 0], [0, 20, 10], [0, -30, 0]])
    assert found == {"wrist.motor": {"wrist": 1.0, "flange": 0.5}}
    found = shafts([[0, 2, -8], [0, 1, 0], [0, 0, 1]])
    assert found == {"waist.motor": {"wrist": -0.25, "flange": 1.0}}
    gear = {"matrix": [[1, 0, 0], [0, 2, 1], [0, 0, 1]]}
    facts = {"mapping": {"gear": gear, "joints": ["waist", "shoulder", "elbow"]}}
    geared = with_gear(robot("puma"), replace(ideal(robot("puma"), duration=1.0), facts=facts))
    assert [shaft.name for shaft in geared.shafts] == ["shoulder.motor"]
    for matrix in ("rows", [["a", 0, 0], [0, 1, 1], [0, 0, 1]], [[1, 0, 0], [0, 1, 1]], None,
                   [[1, 0, 0], [0, 1, float("nan")], [0, 0, 1]], [[1, 1], [1, 1]]):  # fmt: skip
        assert shafts(matrix) == {}
    for names in (7, [1, 2, 3], ["waist", "wrist"]):
        assert shafts(np.ones((3, 3)).tolist(), names) == {}
    assert [coupled_shafts(facts) for facts in ({}, {"mapping": 3})] == [{}, {}]
    wide = np.eye(LONGEST + 1).tolist()
    wide[0][1] = 0.5
    assert shafts(wide, [f"j{k}" for k in range(LONGEST + 1)]) == {}
