"""Recordings come back as they were saved, whole or in parts, and say what is wrong with them."""

from __future__ import annotations

import json
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
from testbed.applications.prediction import longest_segment_motion
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.recordings.columns import check_times
from testbed.core.recordings.formats import parquet
from testbed.core.recordings.geometry import GEOMETRY_TOLERANCE, check_robot, joint_geometry
from testbed.core.recordings.held import without_joints
from testbed.core.recordings.joined import Joined
from testbed.core.recordings.metadata import Metadata
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import gather_parts, open_source
from testbed.core.recordings.views import (
    BASE_JOINTS,
    adapt_to_robot,
    coupled_shafts,
    with_base_joints,
    with_gear_shafts,
)
from testbed.core.robot.free_root import with_free_base
from tests.helpers.ideal import ideal, plus
from tests.helpers.measured import measured
from tests.helpers.parts import write_parts
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
    metadata = Metadata(robot="r", geometry=joint_geometry(tree))
    return replace(made, tare=np.arange(6.0), metadata=metadata)


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
    assert (one.names, one.metadata, one.signals) == (other.names, other.metadata, other.signals)
    assert one.columns().keys() == other.columns().keys()
    for name, values in one.columns().items():
        np.testing.assert_array_equal(values, other.columns()[name])
    np.testing.assert_array_equal(one.tare, other.tare)


@pytest.mark.parametrize("signals", [(), ("velocity",), ("velocity", "acceleration")])
def test_a_recording_without_some_joints_senses_what_it_sensed(
    whole: Recording, signals: tuple[str, ...], tmp_path: Path
) -> None:
    """Velocities without accelerations are no analytic motion: held joints made all speeds zero."""
    for lacking in {"velocity", "acceleration"} - {*signals}:
        whole = without(whole, lacking)
    whole = replace(whole, metadata=Metadata())
    whole.save(tmp_path / "r.parquet")
    stored = open_source(tmp_path / "r.parquet")
    fewer = without_joints(stored, whole.names[:1])
    assert fewer.senses_kinematics == stored.senses_kinematics == (len(signals) == 2)
    assert fewer.names == whole.names[1:]


@few(8)
@given(tree=trees((1, 4)), senses=st.booleans(), lacks=st.sampled_from(["torque", "wrench", ""]))
def test_a_recording_comes_back_bit_for_bit_with_units(
    tree: tb.Tree, senses: bool, lacks: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Truth included; what was not measured is said when asked for."""
    saved = ideal(tree, duration=1.0, rate=50.0)
    if not senses:
        saved = replace(saved, velocity=None, acceleration=None)
    saved = replace(
        without(saved, lacks) if lacks else saved, metadata=Metadata(geometry=joint_geometry(tree))
    )
    path = tmp_path_factory.mktemp("r") / "r.parquet"
    saved.save(path)
    loaded = Recording.load(path)
    same(loaded, saved)
    for name, values in saved.true_columns().items():
        np.testing.assert_array_equal(loaded.true_columns()[name], values)
    assert loaded.senses_kinematics == senses
    sliding = {joint.name for joint in tree.joints if not joint.revolute}
    for field in pq.read_schema(path):
        signal, _, member = field.name.removeprefix("truth/").partition("/")
        angle, torque = ("m", "N") if member in sliding else ("rad", "N m")
        wanted = {"time": "s", "position": angle, "velocity": f"{angle}/s",
                  "acceleration": f"{angle}/s^2", "torque": torque, "friction": torque,
                  "wrench": "N" if member.startswith("F") else "N m"}[signal]  # fmt: skip
        assert field.metadata[b"unit"].decode() == wanted, field.name
    if lacks:
        with refuses(RecordingError, lacks):
            loaded.measured(lacks)


def test_parts_of_a_file_are_those_of_the_whole_in_any_order_and_size(
    whole: Recording, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forward, across row groups, back, the same again, none."""
    stored, n = tb.StoredRecording(path), whole.samples
    assert (stored.names, stored.samples, stored.signals) == (whole.names, n, whole.signals)
    assert stored.rate == pytest.approx(100.0, rel=1e-12)
    spans = [(0, 10), (10, 400), (390, 700), (129, 131), (130, 260), (130, 260), (0, n), (n, n)]
    for first, last in spans:
        part = whole.part(first, last)
        same(stored.part(first, last), part)
        assert part.truth is None
    same(Recording.load(path), whole)
    found = gather_parts(iter(cut(whole)))
    same(found, whole)
    assert not found.position.flags.owndata  # it lies in a file, not in memory
    for named in (path, str(path), cut(whole), whole, stored):
        same(open_source(named).part(0, n), whole.part(0, n))
    one, two, *_ = cut(whole)
    for other in (replace(two, names=("x", "y", "z")), replace(two, torque=None)):
        for make in (
            gather_parts,
            lambda parts: write_parts(parts, path.with_name("other.parquet")),
        ):
            with refuses(RecordingError, "channels"):
                make([one, other])
    monkeypatch.setattr(parquet, "MAX_METADATA_BYTES", 20)
    with refuses(RecordingError, path.name):
        tb.StoredRecording(path)


def test_a_strangers_file_is_not_overwritten(whole: Recording, tmp_path: Path) -> None:
    stranger = tmp_path / "notes.csv"
    for content in (b"time,position\n0,1\n", b"", b"PAR"):
        stranger.write_bytes(content)
        with refuses(RecordingError, stranger.name):
            whole.save(stranger)
        assert stranger.read_bytes() == content


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
    first = tree.joints[0]

    def told(what: str, value: Any) -> Recording:
        said = Metadata(geometry=joint_geometry(tree)).table()["geometry"]
        said[first.name][what] = value
        return replace(whole, metadata=Metadata.parse({"geometry": said}))

    check_robot(replace(whole, metadata=Metadata()), tree)
    check_robot(told("offset", [x + 0.5 * GEOMETRY_TOLERANCE for x in first.offset.tolist()]), tree)
    for what, value, culprit in (
        ("offset", [9.0, 0.0, 0.0], "[9.0, 0.0, 0.0]"),
        ("kind", "prismatic" if first.revolute else "revolute", "kind"),
        ("parent", "elsewhere", "elsewhere"),
        ("axis", [1.0, 0.0, 0.5], "[1.0, 0.0, 0.5]"),
    ):
        with refuses(RecordingError, f"'{first.name}'", culprit):
            check_robot(told(what, value), tree)
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
    """Missing, of texts or dates, infinite, unevenly sampled, in another unit of time."""
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
    single = rewritten(path, "wrench/Fz", pa.array(force.astype(np.float32)))
    np.testing.assert_allclose(Recording.load(single).measured("wrench")[:, 2], force, rtol=1e-6)
    table = pq.read_table(path)
    pq.write_table(table.append_column("time", table["time"]), path.with_name("twice.parquet"))
    with refuses(RecordingError, "'time'"):
        Recording.load(path.with_name("twice.parquet"))
    for count in (0, 1):
        whole.part(0, count).save(path.with_name("short.parquet"))
        with refuses(RecordingError, f"{count} sample"):
            Recording.load(path.with_name("short.parquet"))
    for share in (0.009, -0.009):  # steps may differ by a hundredth
        check_times(np.append(0.0, 1 + share + np.arange(9.0)), "r", 1.0)
        with refuses(RecordingError, "sample 1000"):
            check_times(np.append(0.0, 1 + 1.2 * share + np.arange(9.0)), "r", 1.0, first=1000)


def test_damaged_files_and_metadata_are_refused_in_one_line(path: Path, tmp_path: Path) -> None:
    for name, content in (("a.parquet", b""), ("b.parquet", b"PAR1 truncated"), ("c.doc", b"t")):
        (tmp_path / name).write_bytes(content)
    for name in ("a.parquet", "b.parquet", "c.doc", "", "none.parquet"):
        with refuses(RecordingError, name):
            Recording.load(tmp_path / name)
    for metadata in (
        [1, 2], {"format": "testbed recording 99"}, {"facts": [1]}, {"tare": [1, 2]},
        {"tare": ["a"] * 6}, '{"tare": [NaN, 0, 0, 0, 0, 0]}', {"facts": {"diagnostics": [3]}},
        {"facts": {"diagnostics": [{"code": "note"}]}},
        {"facts": {"gravity": ["down", 0, 0]}}, {"facts": {"geometry": {"j1": 3}}},
        "[" * 100_000 + "]" * 100_000, "{", '"\\ud800',
    ):  # fmt: skip
        other = rewritten(path, "metadata", metadata)
        for read in (Recording.load, tb.StoredRecording):
            with refuses(RecordingError, "other.parquet"):
                read(other)
    joint: list[tuple[str, Any]] = [
        ("kind", "ball"), ("parent", 3), ("axis", [1, 0]), ("axis", [1, 0, float("inf")]),
        ("rotation", [[1, 0, 0], [0, 1], 3]),
    ]  # fmt: skip
    for key, value in joint:
        said = {"geometry": {"fine": {"axis": [1, 0, 0]}, "elbow": {key: value}}}
        with refuses(ValueError, "'elbow'", key):
            Metadata.parse(said)


def test_recordings_as_one_have_what_all_have_and_the_first_ones_tare() -> None:
    one, other = (measured(robot("puma"), seed, duration=1.0) for seed in (1, 2))
    shift = np.arange(6.0)
    moved = replace(plus(other, wrench=shift), tare=np.asarray(other.tare) + shift)
    plain, both = Joined([one, other]), Joined([one, without(moved, "torque")])
    assert "torque" not in both.signals
    for first, last in plain.segments:
        part = both.part(first, last)
        assert part.torque is None
        wrench = plain.part(first, last).measured("wrench")
        np.testing.assert_allclose(part.measured("wrench"), wrench, atol=1e-9)


def test_a_recording_with_a_gap_is_one_file_and_its_segments_are_read_as_recordings(
    tmp_path: Path,
) -> None:
    """In memory and from a file, of one's joints only, too; what is shown is the longest."""
    tree, path = robot("puma"), tmp_path / "r.parquet"
    made = measured(tree, 3, duration=5.0)
    first, begin, end = made.samples // 3, made.samples // 2, made.samples
    parts = [replace(made.part(0, first), tare=made.tare), made.part(begin, end)]
    gaps = (float(parts[1].time[0]), 1e3)  # the other one is not of it
    whole = replace(gather_parts(parts), metadata=replace(made.metadata, gaps=gaps))
    whole.save(path)
    loaded, stored = Recording.load(path), open_source(path)
    same(loaded, whole)
    segments = ((0, first), (first, first + end - begin))
    for each in (whole, loaded, stored, without_joints(stored, whole.names[:1])):
        assert each.segments == segments
        assert each.rate == pytest.approx(made.rate)
    assert loaded.part(*segments[1]).rate == parts[1].rate
    assert loaded.part(first - 9, first + 9).segments == ((0, 9), (9, 18))
    joined, apart = Joined([stored, parts[0]]), Joined([*parts, parts[0]])
    assert joined.segments == apart.segments
    for segment in apart.segments:
        for name, values in apart.part(*segment).columns().items():
            np.testing.assert_array_equal(joined.part(*segment).columns()[name], values)
    wanted = tb.identify(tree, Joined(parts))
    for shown in (whole, path, Joined([whole])):
        np.testing.assert_array_equal(tb.identify(tree, shown).values, wanted.values)
    motion, inner = longest_segment_motion(whole)
    alone, own = longest_segment_motion(parts[1])
    np.testing.assert_array_equal(motion.qdd, alone.qdd)
    assert inner == slice(own.start + first, own.stop + first)
    with refuses(SettingsError, "gap"):
        tb.identify(tree, path, settings=tb.Settings(span=(0.0, 1.0)))
    replace(whole, metadata=made.metadata).save(path)
    with refuses(RecordingError, "uniform", f"sample {first - 1}"):
        Recording.load(path)


def test_a_base_that_was_measured_is_six_joints_more_in_memory_and_in_a_file(
    tmp_path: Path,
) -> None:
    free, recording = riding(11)
    recording.save(tmp_path / "r.parquet")
    whole = with_base_joints(recording)
    source = adapt_to_robot(open_source(tmp_path / "r.parquet"), free)
    assert source.names == whole.names == (*BASE_JOINTS, *recording.names)
    for first, last in ((0, 100), (100, recording.samples)):
        same(replace(source.part(first, last), metadata=Metadata()), whole.part(first, last))
    assert adapt_to_robot(whole, free) is whole
    fixed = ideal(robot("puma"), duration=1.0)
    assert adapt_to_robot(fixed, robot("puma")) is fixed
    fixed.save(tmp_path / "fixed.parquet")
    for without_base in (fixed, open_source(tmp_path / "fixed.parquet")):
        with refuses(RecordingError, "base"):
            adapt_to_robot(without_base, with_free_base(robot("puma")))


def test_shafts_of_coupled_gears_are_named_after_their_own_joint_and_nothing_is_trusted() -> None:
    joints, square = ["waist", "shoulder", "elbow"], np.ones((3, 3)).tolist()
    cases: list[tuple[Any, Any, dict[str, Any]]] = [
        ([[40, 0, 0], [0, 20, 10], [0, -30, 0]], joints,
         {"shoulder.motor": {"shoulder": 1.0, "elbow": 0.5}}),
        ([[0, 2, -8], [0, 1, 0], [0, 0, 1]], joints,
         {"waist.motor": {"shoulder": -0.25, "elbow": 1.0}}),
        *((matrix, joints, {}) for matrix in
          ("rows", [["a", 0, 0], [0, 1, 1], [0, 0, 1]], [[1, 0, 0], [0, 1, 1]], None,
           [[1, 0, 0], [0, 1, np.nan], [0, 0, 1]])),
        *((square, names, {}) for names in (7, ["waist", "elbow"])),
    ]  # fmt: skip
    tree, recording = robot("puma"), ideal(robot("puma"), duration=1.0)
    for matrix, names, wanted in cases:
        mapping = {"gear": {"matrix": matrix}, "joints": names}
        assert coupled_shafts(mapping) == wanted
        geared = with_gear_shafts(tree, replace(recording, metadata=Metadata(mapping=mapping)))
        assert [shaft.name for shaft in geared.shafts] == list(wanted)
    assert [coupled_shafts(mapping) for mapping in ({}, {"joints": 3})] == [{}, {}]
