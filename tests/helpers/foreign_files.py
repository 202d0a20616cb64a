"""The same joints and channels in every foreign format, each by the format's own library."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
    np.savetxt(folder / "log.csv", table, "%.17g", ",", header=",".join(names), comments="")
    source = '[sources.log]\nfile = "log.csv"\ntime = "t"\ntime_unit = "s"'
    return mapping(source, names[1:3], names[3:5], names[5:])


def npz(folder: Path, log: Log) -> str:
    """NumPy's archive."""
    np.savez(folder / "log.npz", **vars(log))
    return by_arrays("log.npz")


def mat(folder: Path, log: Log) -> str:
    """MATLAB 5, packed, in a struct."""
    savemat(folder / "log.mat", {"log": vars(log)}, do_compression=True)
    return by_arrays("log.mat", "log/")


def mat73(folder: Path, log: Log) -> str:
    """MATLAB 7.3: HDF5 with a head of its own, axes the other way round."""
    path = folder / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in vars(log).items():
            made = file.create_dataset(f"log/{name}", data=np.atleast_2d(values.T))
            made.attrs["MATLAB_class"] = np.bytes_("double")
    data = bytearray(path.read_bytes())
    data[:128] = b"MATLAB 7.3 MAT-file".ljust(116) + b"\0" * 8 + b"\0\2IM"
    path.write_bytes(data)
    return by_arrays("log.mat", "log/")


def hdf5(folder: Path, log: Log) -> str:
    """HDF5."""
    with h5py.File(folder / "log.h5", "w") as file:
        for name, values in vars(log).items():
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


def _mcap(
    path: Path, encoding: str, schemas: Sequence[tuple[str, bytes]],
    sent: Iterable[tuple[int, int, int, bytes]], packed: CompressionType,
) -> None:  # fmt: skip
    """MCAP of joint states and a plate: topic, instants of log and publication [ns], message."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, compression=packed)
        writer.start()
        kind, channels = {"json": "jsonschema"}.get(encoding, encoding), []
        for topic, (name, schema) in zip(("/joint_states", "/plate"), schemas, strict=True):
            number = writer.register_schema(name, kind, schema)
            channels.append(writer.register_channel(topic, encoding, number))
        for k, logged, published, message in sent:
            writer.add_message(channels[k], logged, message, published)
        writer.finish()  # type: ignore[no-untyped-call]


def mcap_json(folder: Path, log: Log) -> str:
    """MCAP with JSON, packed by zstd: names in a list, a plate that is a list."""
    schema = "State", b'{"type": "object", "properties": {"name": {"type": "array"}}}'

    def sent() -> Iterator[tuple[int, int, int, bytes]]:
        for k, t in enumerate(log.t):
            when = EPOCH + round(t * 1e9)
            head = {"stamp": {"sec": when // 10**9, "nanosec": when % 10**9}}
            arm = {"name": JOINTS, "position": log.q[k].tolist(), "effort": log.tau[k].tolist()}
            finger = {"name": ["finger"], "position": [log.q[k, 0]], "effort": [0.0]}
            force, torque = (
                dict(zip("xyz", part.tolist(), strict=True)) for part in log.w[k].reshape(2, 3)
            )
            plate = {"wrench": {"force": force, "torque": torque}}
            for topic, content, later in ((0, arm, 0), (0, finger, GRIPPER), (1, plate, 0)):
                message = json.dumps({"header": head, **content}).encode()
                yield topic, when + later, when, message

    _mcap(folder / "log.mcap", "json", [schema, schema], sent(), CompressionType.ZSTD)
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
    schemas = [(kind.DESCRIPTOR.full_name, schema.SerializeToString()) for kind in kinds]

    def sent() -> Iterator[tuple[int, int, int, bytes]]:
        for k, t in enumerate(log.t):
            when = EPOCH + round(t * 1e9)
            states, plate = kinds[0](), kinds[1](wrench=log.w[k])
            for j, name in enumerate(JOINTS):
                states.joints.add(name=name, position=log.q[k, j], effort=log.tau[k, j])
            for topic, message in enumerate((states, plate)):
                message.timestamp.FromNanoseconds(when)
                yield topic, when, when, message.SerializeToString()

    _mcap(folder / "log.mcap", "protobuf", schemas, sent(), CompressionType.LZ4)
    plate = [f"wrench[{k}]" for k in range(6)]
    return _topics("log.mcap", "timestamp", "joints/{joint}/{signal}", plate)


def rrd(folder: Path, log: Log) -> str:
    """Rerun's recording: an entity a joint's signal, a plate of six numbers, a step that counts."""
    stream = rr.RecordingStream("log", recording_id="log")
    stream.save(folder / "log.rrd")
    times = [rr.TimeColumn("t", duration=log.t), rr.TimeColumn("step", sequence=range(len(log.t)))]
    for name, values in (("position", log.q), ("effort", log.tau)):
        for j, joint in enumerate(JOINTS):
            columns = rr.Scalars.columns(scalars=values[:, j])
            stream.send_columns(f"{name}/{joint}", indexes=times, columns=columns)
    columns = rr.Scalars.columns(scalars=log.w)
    stream.send_columns("plate/wrench", indexes=times, columns=columns)
    stream.log("position", rr.SeriesLines(names="q"), static=True)
    stream.flush()
    stream.disconnect()
    position, torque = ([f"{name}/{j}" for j in JOINTS] for name in ("position", "effort"))
    source = '[sources.log]\nfile = "log.rrd"\ntopic = "position/j1"\ntime = "t"'
    return mapping(source, position, torque, [f"plate/wrench[{k}]" for k in range(6)])


def lerobot(folder: Path, log: Log, version: str = "v3.0", episodes: int = 1) -> str:
    """LeRobot's dataset: lists in a Parquet file of all episodes (3.0), or one of each (2.1)."""
    n, place, motors = len(log.t) // episodes, folder / "log", [f"{j}.pos" for j in JOINTS]
    lists: dict[str, tuple[Array, Any]] = {
        "observation.state": (log.q, motors), "observation.effort": (log.tau, {"motors": JOINTS}),
        "observation.wrench": (log.w, None), "action": (log.q + 0.1, motors),
    }  # fmt: skip
    own: dict[str, Any] = {
        "timestamp": np.tile(log.t[:n], episodes).astype(np.float32),
        "frame_index": np.tile(np.arange(n), episodes),
        "episode_index": np.repeat(np.arange(episodes), n),
        "index": np.arange(n * episodes), "task_index": np.zeros(n * episodes, int),
    }  # fmt: skip
    features: dict[str, Any] = {
        name: {"dtype": "float64", "shape": [values.shape[1]], "names": names}
        for name, (values, names) in lists.items()
    }
    for name, values in own.items():
        features[name] = {"dtype": str(values.dtype), "shape": [1], "names": None}
    video = {"dtype": "video", "shape": [48, 64, 3], "names": ["height", "width", "channel"]}
    features["observation.images.top"] = video
    columns: dict[str, Any] = {
        name: pa.array(values[: n * episodes].tolist(), pa.list_(pa.float64()))
        for name, (values, _) in lists.items()
    }
    whole = pa.table(columns | own)
    data = place / "data/chunk-000"
    data.mkdir(parents=True)
    (place / "meta").mkdir()
    old = version.startswith("v2")
    files = [f"episode_{k:06d}.parquet" for k in range(episodes)] if old else ["file-000.parquet"]
    count = n if old else n * episodes
    for k, name in enumerate(files):
        pq.write_table(whole.slice(k * count, count), data / name)
    pattern = ("data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet" if old
               else "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet")  # fmt: skip
    info = {"codebase_version": version, "robot_type": "two", "features": features,
            "total_episodes": episodes, "total_frames": n * episodes, "data_path": pattern,
            "fps": round(1 / float(np.median(np.diff(log.t))))}  # fmt: skip
    (place / "meta/info.json").write_text(json.dumps(info))
    position = [f"observation.state/{j}.pos" for j in JOINTS]
    torque = [f"observation.effort/{j}" for j in JOINTS]
    source = '[sources.log]\nfile = "log"\ntime = "timestamp"'
    return mapping(source, position, torque, [f"observation.wrench[{k}]" for k in range(6)])


FORMATS: dict[str, Callable[[Path, Log], str]] = {
    "csv": csv, "npz": npz, "mat": mat, "mat73": mat73, "hdf5": hdf5, "parquet": parquet,
    "bare_mcap": partial(ros2_file, plugin=StoragePlugin.MCAP, ending="mcap"),
    "db3": partial(ros2_file, plugin=StoragePlugin.SQLITE3, ending="db3"), "bag": bag, "c3d": c3d,
    "mcap_json": mcap_json, "mcap_protobuf": mcap_protobuf, "rrd": rrd,
}  # fmt: skip
"""Each writes its file into a folder and returns the mapping."""


WRENCH = tuple(f"wrench/{part}/{axis}" for part in ("force", "torque") for axis in "xyz")


def _topics(
    file: str, time: str = "stamp", form: str = "{signal}/{joint}", plate: Sequence[str] = WRENCH
) -> str:
    """Of joint states and a plate, each a topic of its own."""
    sources = "\n".join(
        f'[sources.{name}]\nfile = "{file}"\ntopic = "{topic}"\ntime = "{time}"'
        for name, topic in (("log", "/joint_states"), ("plate", "/plate"))
    )
    position, torque = (
        [form.format(signal=signal, joint=j) for j in JOINTS] for signal in ("position", "effort")
    )
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
            arm = [JOINTS[j] for j in order], log.q[k, order], log.tau[k, order], 0
            finger = ["finger"], log.q[k, :1], np.zeros(1), GRIPPER
            for names, position, effort, later in (arm, finger):
                told = kinds[state](head, names, position, np.zeros(len(names)), effort)
                writer.write(states, when + later, pack(told, state))
            felt = kinds["geometry_msgs/msg/Wrench"](vector(*log.w[k, :3]), vector(*log.w[k, 3:]))
            writer.write(wrenches, when, pack(kinds[wrench](header=head, wrench=felt), wrench))
    return _topics(path.name)
