"""Datasets of robot learning and columns of known loggers are read without a word of a person."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import rerun as rr
from mcap.writer import Writer

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.importing.convert import import_recordings
from testbed.importing.foreign_table import ForeignTable
from testbed.importing.guess import guess_mapping
from testbed.importing.known_layouts import LAYOUTS
from testbed.importing.readers import open_foreign_table, read_tables
from tests.helpers.foreign_files import EPOCH, FORMATS, JOINTS, lerobot, some_log
from tests.helpers.refusals import refuses


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes_are_recordings_of_their_own(version: str, tmp_path: Path) -> None:
    """A file each or one of all: each to the last bit; paths that it states are not."""
    log = some_log(600)
    (tmp_path / "map.toml").write_text(lerobot(tmp_path, log, version, 3))
    info = tmp_path / "log/meta/info.json"
    said = json.loads(info.read_text())
    info.write_text(json.dumps(said | {"data_path": "../../../../{episode_index.__class__}"}))
    found, cuts = import_recordings(tmp_path / "map.toml")
    assert [each.samples for each in found] == [200, 200, 200]
    assert [each.code for each in cuts] == ["import.cut"] * 2
    for k, each in enumerate(found):
        rows = slice(200 * k, 200 * (k + 1))
        for signal, wanted in (("position", log.q), ("torque", log.tau), ("wrench", log.w)):
            np.testing.assert_allclose(each.measured(signal), wanted[rows], atol=1e-4)
    (file, *_) = sorted((tmp_path / "log/data").rglob("*.parquet"))
    assert open_foreign_table(file).columns == open_foreign_table(tmp_path / "log").columns
    draft = guess_mapping([tmp_path / "log"], tmp_path, JOINTS).tables
    assert draft["position"]["columns"] == [f"observation.state/{j}.pos" for j in JOINTS]
    assert draft["torque"]["columns"] == [f"observation.effort/{j}" for j in JOINTS]
    info.write_text(json.dumps(said | {"codebase_version": "v1.6"}))
    with refuses(RecordingError, "v1.6"):
        open_foreign_table(tmp_path / "log")


ARM = "observation/robot_state/"
LOGGERS: dict[str, tuple[str, str, tuple[str, ...], dict[str, str]]] = {
    "libfranka": (
        "log.csv", "{name}[{k}]", ("state.q", "state.dq", "state.tau_J"),
        {"state.q_d": "q", "state.tau_J_d": "tau", "state.tau_ext_hat_filtered": "tau",
         "state.O_F_ext_hat_K": "w"}),
    "UR's RTDE": ("log.csv", "{name}_{k}", ("actual_q", "actual_qd", "actual_current"),
                  {"target_q": "q", "actual_TCP_force": "w"}),
    "DROID": ("log.h5", "{name}[{k}]", (f"{ARM}joint_positions", f"{ARM}joint_velocities",
              f"{ARM}motor_torques_measured"), {f"{ARM}joint_torques_computed": "tau"}),
    "ALOHA": ("log.hdf5", "{name}[{k}]",
              ("observations/qpos", "observations/qvel", "observations/effort"), {"action": "q"}),
    "KUKA's iiwa": ("log.csv", "{name}_LBR_iiwa_7_R800_1[{k}]", ("axisQMsr", "", "axisTauMsr"),
                    {"axisQCmd": "q", "axisTauExtMsr": "tau"}),
    "Kinova's Gen3": ("log.csv", "{name}{joint}", ("Position", "Velocity", "Torque"),
                      {"TorqueSm": "tau", "PositionCmptd": "q"}),
}  # fmt: skip
"""File, form of columns, positions and velocities and torques; what else it logs, of what kind."""
CURRENTS = {"UR's RTDE": "A", "ALOHA": "mA"}


def times(logger: str, t: Array) -> dict[str, Array]:
    """Columns of a logger's clock, of instants since 1970."""
    second, fraction = np.floor(t), 1e9 * (t % 1)
    return {
        "libfranka": {"duration": 1e3 * (t - t[0])},
        "UR's RTDE": {"timestamp": t},
        "DROID": {"observation/timestamp/robot_state/robot_timestamp_nanos": fraction,
                  "observation/timestamp/robot_state/read_start": np.round(1e3 * t)},
        "KUKA's iiwa": {"ZeitInSec": second, "ZeitInNanoSec": np.round(fraction, -3)},
        "Kinova's Gen3": {"Time": 1e3 * (t - t[0])},
    }.get(logger, {})  # fmt: skip


@pytest.mark.parametrize("logger", dict.fromkeys(each.logger for each in LAYOUTS))
def test_a_logger_is_known_by_its_columns(logger: str, tmp_path: Path) -> None:
    """Signals, units and rate; what it commands or estimates is left out."""
    log = some_log(400)
    rates = np.gradient(log.q, 0.01, axis=0)
    name, form, stems, others = LOGGERS[logger]
    signals = {"position": log.q, "velocity": rates, "torque": log.tau}
    said = [each for each in zip(stems, signals.values(), strict=False) if each[0]]
    said += [(other, getattr(log, kind)) for other, kind in others.items()]
    columns = times(logger, 1_700_000_000 + log.t) | {
        form.format(name=stem, k=k, joint=k + 1): column
        for stem, values in said for k, column in enumerate(values.T)
    }  # fmt: skip
    units = {"position": "rad", "velocity": "rad/s", "torque": CURRENTS.get(logger, "N m")}
    units = {kind: unit for (kind, unit), stem in zip(units.items(), stems, strict=False) if stem}
    if name.endswith(".csv"):
        table = np.column_stack([*columns.values()])
        np.savetxt(tmp_path / name, table, "%.9f", ",", header=",".join(columns), comments="")
    else:
        with h5py.File(tmp_path / name, "w") as file:
            for array in dict.fromkeys(each.partition("[")[0] for each in columns):
                parts = [v for column, v in columns.items() if column.partition("[")[0] == array]
                data = np.column_stack(parts) if len(parts) > 1 else parts[0]
                file[array] = data.astype(np.int64) if "timestamp" in array else data
    found = guess_mapping([tmp_path / name], tmp_path, JOINTS).tables
    assert {kind: found[kind]["unit"] for kind in units} == units
    read = open_foreign_table(tmp_path / name)
    for kind in units:
        listed = found[kind]["columns"]
        values = np.column_stack([*read.column_values(listed).values()])
        np.testing.assert_allclose(values, signals[kind], atol=1e-8)
        wrong = ("Cmd", "target", "Ext", "computed", "_d[", "action", "Sm")
        assert not any(word in column for column in listed for word in wrong)
    assert {kind for kind in (*signals, "wrench") if found.get(kind)} == set(units)
    assert found[""]["rate"] == (50 if logger == "ALOHA" else 100)  # whose files have no times


def test_the_size_of_positions_shows_degrees_and_counts(tmp_path: Path) -> None:
    """Not per cent of a calibrated range, which no unit makes an angle; not radians."""
    turns = some_log(400)
    cases = {
        "deg": (np.degrees(turns.q) + 90, "deg"),
        "rad": (turns.q, ""),
        "counts": (np.round(turns.q / (2 * np.pi) * 4096) + 2048, "turn"),
        "per cent": (100 * np.sin(turns.q * 20), ""),
    }
    for name, (values, unit) in cases.items():
        (tmp_path / name).mkdir()
        lerobot(tmp_path / name, replace(turns, q=values))
        position = guess_mapping([tmp_path / name / "log"], tmp_path, JOINTS).tables["position"]
        assert position["unit"] == unit, name
        if name == "counts":
            angle = values * 2 * np.pi @ np.array(position["matrix"]) + position["offset"]
            np.testing.assert_allclose(angle, turns.q, atol=np.pi / 4096 + 1e-6)


def test_a_topic_that_cannot_be_read_hides_no_other(tmp_path: Path) -> None:
    """Numbers of Protobuf that are zero are not sent; times keep their nanoseconds."""
    log = some_log()
    log.tau[:, 1] = 0.0
    FORMATS["mcap_protobuf"](tmp_path, log)
    table = open_foreign_table(tmp_path / "log.mcap", "/joint_states")
    assert not table.column_values(["joints/j2/effort"])["joints/j2/effort"].any()
    assert table.time_stamps("timestamp")[1] - EPOCH == 10**7
    with refuses(RecordingError, "/joint_states", "/plate"):
        open_foreign_table(tmp_path / "log.mcap")
    with (tmp_path / "odd.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        encodings = {"/odd": "pickle", "/joints": "json", "/grows": "json", "/none": "json"}
        channels = {t: writer.register_channel(t, e, 0) for t, e in encodings.items()}
        for k in range(30):
            state = {"name": JOINTS, "position": [k, 0.5], "effort": [0, 2 * k]}
            said = {"/odd": b"cos\n", "/joints": state, "/grows": {"q": [1] * k}}
            for topic, content in said.items():
                data = content if isinstance(content, bytes) else json.dumps(content).encode()
                writer.add_message(channels[topic], EPOCH + k * 10**7, data, EPOCH)
        writer.finish()  # type: ignore[no-untyped-call]
    kinds = {topic: type(each) for topic, each in read_tables(tmp_path / "odd.mcap").items()}
    assert kinds == {"/odd": RecordingError, "/joints": ForeignTable, "/grows": RecordingError,
                     "/none": ForeignTable}  # fmt: skip
    draft = guess_mapping([tmp_path / "odd.mcap"], tmp_path, JOINTS).tables
    assert draft["torque"]["columns"] == ["effort/j1", "effort/j2"]
    assert draft[""]["rate"] == 100


def test_what_was_logged_to_rerun_at_other_times_is_another_table(tmp_path: Path) -> None:
    """In the order of time; what Rerun adds, and what has no time, is no column."""
    stream = rr.RecordingStream("log", recording_id="log")
    stream.save(tmp_path / "log.rrd")
    stream.reset_time()  # of streams before
    order = np.random.default_rng(0).permutation(50)
    for k in order:
        stream.set_time("t", duration=0.01 * k)
        for j, joint in enumerate(JOINTS):
            stream.log(f"arm/position/{joint}", rr.Scalars(float(k + 100 * j)))
        if k % 2 == 0:
            stream.log("plate", rr.Scalars(np.arange(6.0) + k))
    stream.log("arm", rr.SeriesLines(names="q"), static=True)
    stream.flush()
    stream.disconnect()
    found = read_tables(tmp_path / "log.rrd")
    assert [*found] == ["arm/position/j1", "plate"]
    arm = open_foreign_table(tmp_path / "log.rrd", "arm/position/j2")
    assert set(arm.columns) == {"t", "arm/position/j1", "arm/position/j2"}
    read = arm.column_values(arm.columns)
    np.testing.assert_array_equal(read["t"], 1e7 * np.arange(50))
    np.testing.assert_array_equal(read["arm/position/j2"], np.arange(50) + 100)
    plate = open_foreign_table(tmp_path / "log.rrd", "plate").column_values(["plate[5]"])[
        "plate[5]"
    ]
    np.testing.assert_array_equal(plate, np.arange(0, 50, 2) + 5)
