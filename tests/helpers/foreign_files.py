"""The same joints and channels in every foreign format, each by the format's own library."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import ezc3d
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import rerun as rr
from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

import testbed as tb
from testbed.core.base.arrays import Array

JOINTS = ("j1", "j2")
GRIPPER = 3_000_000
"""Later than the arm's the gripper's states are sent [ns]."""

EPOCH = 1_700_000_000_000_000_000
"""Of the clocks of ROS in these files [ns]."""


@dataclass(frozen=True, eq=False)
class Log:
    """What was measured, at 100 Hz."""

    t: Array
    q: Array
    tau: Array
    w: Array
    names: tuple[str, ...] = JOINTS

    @property
    def arrays(self) -> dict[str, Array]:
        """What was measured, by name."""
        return {"t": self.t, "q": self.q, "tau": self.tau, "w": self.w}


def some_log(samples: int = 60) -> Log:
    """Two joints and a plate that mean nothing."""
    rng = np.random.default_rng(0)
    q = np.cumsum(rng.normal(size=(samples, 2)), axis=0) * 0.01
    tau, w = rng.normal(size=(samples, 2)), rng.normal(size=(samples, 6))
    return Log(np.arange(samples) / 100, q, tau, w)


def mapping(
    sources: str, position: Sequence[str], torque: Sequence[str], wrench: Sequence[str],
    plate: str = "log",
) -> str:  # fmt: skip
    """A mapping file of columns by name."""
    return (
        f'rate = 100\njoints = ["j1", "j2"]\n{sources}\n'
        f'[position]\nsource = "log"\nunit = "rad"\ncolumns = {json.dumps(position)}\n'
        f'[torque]\nsource = "log"\nunit = "N m"\ncolumns = {json.dumps(torque)}\n'
        f'[wrench]\nsource = "{plate}"\nunits = ["N", "N m"]\nsense = "on_robot"\n'
        f"columns = {json.dumps(wrench)}\n"
    )


def by_arrays(file: str, before: str = "", unit: str = 'time_unit = "s"') -> str:
    """Of a file that holds t, q, tau, w."""
    names = [f"{before}{name}" for name in ("q[0]", "q[1]", "tau[0]", "tau[1]")]
    plate = [f"{before}w[{k}]" for k in range(6)]
    source = f'[sources.log]\nfile = "{file}"\ntime = "{before}t"\n{unit}'
    return mapping(source, names[:2], names[2:], plate)


def csv(folder: Path, log: Log) -> str:
    """Lines of text."""
    names = ["t", "q1", "q2", "t1", "t2", *"abcdef"]
    table = np.column_stack([log.t, log.q, log.tau, log.w])
    lines = [",".join(names), *(",".join(repr(float(x)) for x in row) for row in table)]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    source = '[sources.log]\nfile = "log.csv"\ntime = "t"\ntime_unit = "s"'
    return mapping(source, names[1:3], names[3:5], names[5:])


def npz(folder: Path, log: Log) -> str:
    """NumPy's archive."""
    np.savez(folder / "log.npz", **log.arrays)  # type: ignore[arg-type]
    return by_arrays("log.npz")


def mat(folder: Path, log: Log) -> str:
    """MATLAB 5, packed, in a struct."""
    savemat(folder / "log.mat", {"log": log.arrays}, do_compression=True)
    return by_arrays("log.mat", "log/")


def mat73(folder: Path, log: Log) -> str:
    """MATLAB 7.3: HDF5 with a head of its own, axes the other way round."""
    path = folder / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in log.arrays.items():
            made = file.create_dataset(f"log/{name}", data=np.atleast_2d(values.T))
            made.attrs["MATLAB_class"] = np.bytes_("double")
    data = bytearray(path.read_bytes())
    data[:128] = b"MATLAB 7.3 MAT-file".ljust(116) + b"\0" * 8 + b"\0\2IM"
    path.write_bytes(data)
    return by_arrays("log.mat", "log/")


def hdf5(folder: Path, log: Log) -> str:
    """HDF5."""
    with h5py.File(folder / "log.h5", "w") as file:
        for name, values in log.arrays.items():
            file.create_dataset(f"log/{name}", data=values)
    return by_arrays("log.h5", "log/")


def parquet(folder: Path, log: Log) -> str:
    """Parquet, with lists and instants."""
    columns: dict[str, Any] = {
        "t": pa.array((log.t * 1e9).round().astype("int64"), "timestamp[ns]")
    }
    for name in ("q", "tau", "w"):
        values = getattr(log, name)
        columns[name] = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
    pq.write_table(pa.table(columns), folder / "log.parquet")
    return by_arrays("log.parquet", unit="")


def ros2_file(folder: Path, log: Log, plugin: StoragePlugin, ending: str) -> str:
    """The file of a ROS 2 bag, without its folder."""
    _bag(folder / "log", log, plugin)
    (file,) = (folder / "log").glob(f"*.{ending}")
    file.rename(folder / f"log.{ending}")
    return _topics(f"log.{ending}")


def bag(folder: Path, log: Log) -> str:
    """A ROS 1 bag."""
    return _bag(folder / "log.bag", log, None)


def c3d(folder: Path, log: Log) -> str:
    """C3D, whose numbers are of single precision."""
    names = ("q1", "q2", "t1", "t2", *"abcdef")
    channels = np.column_stack([log.q, log.tau, log.w]).T
    write_c3d(folder / "log.c3d", channels, np.zeros((3, 0, len(log.t))), ANALOG={"LABELS": names})
    columns = [f"analog/{name}" for name in names]
    source = '[sources.log]\nfile = "log.c3d"\ntime = "analog/time"'
    return mapping(source, columns[:2], columns[2:4], columns[4:])


def write_c3d(path: Path, channels: Array, points: Array, **words: Mapping[str, Any]) -> None:
    """A C3D file of 100 frames a second, one sample of each channel a frame.

    Args:
        path: The file.
        channels: (C, M).
        points: (3, P, M).
        words: Labels, units ... of ANALOG and POINT; what there is of other groups.
    """
    made = ezc3d.c3d()
    for group in ("ANALOG", "POINT"):
        for name, value in {"RATE": [100.0], **words.pop(group, {})}.items():
            made["parameters"][group][name]["value"] = value
    for group, values in words.items():
        for name, value in values.items():
            made.add_parameter(group, name, np.asarray(value, dtype=np.float64))
    made["data"]["points"] = np.concatenate([points, np.ones((1, *points.shape[1:]))])
    made["data"]["analogs"] = channels[None]
    made.write(str(path))


def imported(folder: Path, text: str) -> tb.Recording:
    """What a mapping of the files in a folder makes."""
    (folder / "map.toml").write_text(text)
    return tb.import_recording(folder / "map.toml")


def mcap_json(folder: Path, log: Log) -> str:
    """MCAP with JSON, packed by zstd: names in a list, a plate that is a list."""
    states = {"type": "object", "properties": {"name": {"type": "array"}}}
    head = {"stamp": {"sec": EPOCH // 10**9, "nanosec": 0}}

    def state(k: int, when: int) -> dict[str, Any]:
        head["stamp"] = {"sec": when // 10**9, "nanosec": when % 10**9}
        motion = {"position": log.q[k].tolist(), "effort": log.tau[k].tolist()}
        return {"header": head, "name": log.names, **motion}

    def finger(k: int, when: int) -> dict[str, Any]:
        return {"header": head, "name": ["finger"], "position": [log.q[k, 0]], "effort": [0.0]}

    def plate(k: int, when: int) -> dict[str, Any]:
        force, torque = (
            dict(zip("xyz", part.tolist(), strict=True)) for part in log.w[k].reshape(2, 3)
        )
        return {"header": head, "wrench": {"force": force, "torque": torque}}

    with (folder / "log.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        schema = writer.register_schema("State", "jsonschema", json.dumps(states).encode())
        channels = [writer.register_channel(t, "json", schema) for t in ("/joint_states", "/plate")]
        sent = ((channels[0], state, 0), (channels[0], finger, GRIPPER), (channels[1], plate, 0))
        for k, t in enumerate(log.t):
            when = EPOCH + round(t * 1e9)
            for channel, content, later in sent:
                data = json.dumps(content(k, when)).encode()
                writer.add_message(channel, when + later, data, when)
        writer.finish()  # type: ignore[no-untyped-call]
    return _topics("log.mcap")


def protobuf_schema() -> FileDescriptorSet:
    """Foxglove's JointStates and a plate: what a recorder keeps of their definitions."""
    kind = FieldDescriptorProto
    stamp = FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    file = FileDescriptorProto(
        name="foxglove/JointStates.proto", package="foxglove", syntax="proto3",
        dependency=[stamp.name],
    )  # fmt: skip
    time = {"type": kind.TYPE_MESSAGE, "type_name": ".google.protobuf.Timestamp", "label": 1}
    state = file.message_type.add(name="JointState")
    state.field.add(name="name", number=1, type=kind.TYPE_STRING, label=1)
    for k, name in enumerate(("position", "velocity", "acceleration", "effort")):
        state.oneof_decl.add(name=f"_{name}")
        state.field.add(name=name, number=k + 2, type=kind.TYPE_DOUBLE, label=1,
                        proto3_optional=True, oneof_index=k)  # fmt: skip
    states = file.message_type.add(name="JointStates")
    states.field.add(name="timestamp", number=1, **time)
    states.field.add(name="joints", number=2, type=kind.TYPE_MESSAGE, label=3,
                     type_name=".foxglove.JointState")  # fmt: skip
    plate = file.message_type.add(name="Plate")
    plate.field.add(name="timestamp", number=1, **time)
    plate.field.add(name="wrench", number=2, type=kind.TYPE_DOUBLE, label=3)
    return FileDescriptorSet(file=[stamp, file])


def mcap_protobuf(folder: Path, log: Log) -> str:
    """MCAP with Protobuf, packed by lz4: Foxglove's joint states, and a plate that is a list."""
    schema = protobuf_schema()
    pool = DescriptorPool()
    for file in schema.file:
        pool.Add(file)
    kinds: list[Any] = [
        GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))
        for name in ("JointStates", "Plate")
    ]
    with (folder / "log.mcap").open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType.LZ4)
        writer.start()
        channels = [
            writer.register_channel(topic, "protobuf", writer.register_schema(
                kind.DESCRIPTOR.full_name, "protobuf", schema.SerializeToString()))
            for topic, kind in zip(("/joint_states", "/plate"), kinds, strict=True)
        ]  # fmt: skip
        for k, t in enumerate(log.t):
            when = EPOCH + round(t * 1e9)
            states, plate = kinds[0](), kinds[1](wrench=log.w[k])
            for j, name in enumerate(log.names):
                states.joints.add(name=name, position=log.q[k, j], effort=log.tau[k, j])
            for channel, message in zip(channels, (states, plate), strict=True):
                message.timestamp.FromNanoseconds(when)
                writer.add_message(channel, when, message.SerializeToString(), when)
        writer.finish()  # type: ignore[no-untyped-call]
    sources = "\n".join(
        f'[sources.{name}]\nfile = "log.mcap"\ntopic = "{topic}"\ntime = "timestamp"'
        for name, topic in (("log", "/joint_states"), ("plate", "/plate"))
    )
    position, torque = (
        [f"joints/{j}/{what}" for j in log.names] for what in ("position", "effort")
    )
    return mapping(sources, position, torque, [f"wrench[{k}]" for k in range(6)], plate="plate")


def rrd(folder: Path, log: Log) -> str:
    """Rerun's recording: an entity a joint's signal, a plate of six numbers, a step that counts."""
    stream = rr.RecordingStream("log", recording_id="log")
    stream.save(folder / "log.rrd")
    times = [rr.TimeColumn("t", duration=log.t), rr.TimeColumn("step", sequence=range(len(log.t)))]
    for name, values in (("position", log.q), ("effort", log.tau)):
        for j, joint in enumerate(log.names):
            columns = rr.Scalars.columns(scalars=values[:, j])
            stream.send_columns(f"{name}/{joint}", indexes=times, columns=columns)
    columns = rr.Scalars.columns(scalars=log.w)
    stream.send_columns("plate/wrench", indexes=times, columns=columns)
    stream.log("position", rr.SeriesLines(names="q"), static=True)
    stream.flush()
    stream.disconnect()
    position, torque = ([f"{name}/{j}" for j in log.names] for name in ("position", "effort"))
    source = '[sources.log]\nfile = "log.rrd"\ntopic = "position/j1"\ntime = "t"'
    return mapping(source, position, torque, [f"plate/wrench[{k}]" for k in range(6)])


def lerobot(folder: Path, log: Log, version: str = "v3.0", episodes: int = 1) -> str:
    """LeRobot's dataset: lists in a Parquet file of all episodes (3.0), or one of each (2.1)."""
    n, place, motors = len(log.t) // episodes, folder / "log", [f"{j}.pos" for j in log.names]
    lists = {"observation.state": log.q, "observation.effort": log.tau,
             "observation.wrench": log.w, "action": log.q + 0.1}  # fmt: skip
    names: dict[str, Any] = {
        "observation.state": motors, "observation.effort": {"motors": [*log.names]},
        "observation.wrench": None, "action": motors,
    }  # fmt: skip
    features: dict[str, Any] = {
        name: {"dtype": "float64", "shape": [values.shape[1]], "names": names[name]}
        for name, values in lists.items()
    }
    video = {"dtype": "video", "shape": [48, 64, 3], "names": ["height", "width", "channel"]}
    features["observation.images.top"] = video
    counts = ("timestamp", "frame_index", "episode_index", "index", "task_index")
    for name in counts:
        kind = "float32" if name == "timestamp" else "int64"
        features[name] = {"dtype": kind, "shape": [1], "names": None}
    tables = []
    for episode in range(episodes):
        rows = slice(episode * n, (episode + 1) * n)
        columns: dict[str, Any] = {
            name: pa.array(values[rows].tolist(), pa.list_(pa.float64()))
            for name, values in lists.items()
        }
        columns["timestamp"] = pa.array(log.t[:n].astype(np.float32))
        own = np.arange(n), np.full(n, episode), np.arange(n) + episode * n, np.zeros(n, int)
        columns |= dict(zip(counts[1:], own, strict=True))
        tables.append(pa.table(columns))
    data = place / "data/chunk-000"
    data.mkdir(parents=True)
    (place / "meta").mkdir()
    old = version.startswith("v2")
    files = [f"episode_{k:06d}.parquet" for k in range(episodes)] if old else ["file-000.parquet"]
    for name, table in zip(files, tables if old else [pa.concat_tables(tables)], strict=True):
        pq.write_table(table, data / name)
    pattern = ("data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet" if old
               else "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet")  # fmt: skip
    info = {"codebase_version": version, "robot_type": "two", "features": features,
            "total_episodes": episodes, "total_frames": n * episodes, "data_path": pattern,
            "fps": round(1 / float(np.median(np.diff(log.t))))}  # fmt: skip
    (place / "meta/info.json").write_text(json.dumps(info))
    position = [f"observation.state/{j}.pos" for j in log.names]
    torque = [f"observation.effort/{j}" for j in log.names]
    source = '[sources.log]\nfile = "log"\ntime = "timestamp"'
    return mapping(source, position, torque, [f"observation.wrench[{k}]" for k in range(6)])


FORMATS: dict[str, Callable[[Path, Log], str]] = {
    "csv": csv, "npz": npz, "mat": mat, "mat73": mat73, "hdf5": hdf5, "parquet": parquet,
    "bare_mcap": partial(ros2_file, plugin=StoragePlugin.MCAP, ending="mcap"),
    "db3": partial(ros2_file, plugin=StoragePlugin.SQLITE3, ending="db3"), "bag": bag, "c3d": c3d,
    "mcap_json": mcap_json, "mcap_protobuf": mcap_protobuf, "rrd": rrd,
}  # fmt: skip
"""Each writes its file into a folder and returns the mapping."""


def _topics(file: str) -> str:
    sources = "\n".join(
        f'[sources.{name}]\nfile = "{file}"\ntopic = "{topic}"\ntime = "stamp"'
        for name, topic in (("log", "/joint_states"), ("plate", "/plate"))
    )
    plate = [f"wrench/{part}/{axis}" for part in ("force", "torque") for axis in "xyz"]
    position, torque = ([f"{what}/{j}" for j in JOINTS] for what in ("position", "effort"))
    return mapping(sources, position, torque, plate, plate="plate")


def _bag(path: Path, log: Log, plugin: StoragePlugin | None) -> str:
    """Joint states whose names change places, those of a gripper's node, and wrenches."""
    store = get_typestore(Stores.ROS1_NOETIC if plugin is None else Stores.ROS2_HUMBLE)
    kinds = store.types
    state, wrench = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"
    vector = kinds["geometry_msgs/msg/Vector3"]
    pack = store.serialize_ros1 if plugin is None else store.serialize_cdr
    writer: Any = (
        Writer1(path) if plugin is None else Writer(path, version=9, storage_plugin=plugin)
    )
    with writer:
        states = writer.add_connection("/joint_states", state, typestore=store)
        wrenches = writer.add_connection("/plate", wrench, typestore=store)
        for k, t in enumerate(log.t):
            when = EPOCH + round(t * 1e9)
            stamp = kinds["builtin_interfaces/msg/Time"](when // 10**9, when % 10**9)
            number = {"seq": k} if plugin is None else {}
            head = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **number)
            order = [0, 1] if k % 2 else [1, 0]
            told = kinds[state](
                header=head, name=[JOINTS[j] for j in order], position=log.q[k, order],
                velocity=np.zeros(2), effort=log.tau[k, order],
            )  # fmt: skip
            felt = kinds["geometry_msgs/msg/Wrench"](vector(*log.w[k, :3]), vector(*log.w[k, 3:]))
            writer.write(states, when, pack(told, state))
            finger = kinds[state](
                header=head, name=["finger"], position=log.q[k, :1], velocity=np.zeros(1),
                effort=np.zeros(1),
            )  # fmt: skip
            writer.write(states, when + GRIPPER, pack(finger, state))
            writer.write(wrenches, when, pack(kinds[wrench](header=head, wrench=felt), wrench))
    return _topics(path.name)
