"""Hostile files of LeRobot, MCAP, Rerun and known HDF5 layouts: good ones spoiled, and traps."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import rerun as rr
from google.protobuf import struct_pb2
from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin

from benchmarks.hostile.edits import changed
from tests.helpers.foreign_files import FORMATS, Log, _bag, lerobot, protobuf_schema, some_log

Files = dict[str, bytes]
"""By their paths in the case's folder."""

LEROBOT = ("v2.1", "v3.0")
IMPORT = ("import", "map.toml", "--out", "out.parquet")
OUTPUTS = ("out.parquet", "guess.toml")


def files_of(write: Callable[[Path], object]) -> Files:
    """What a function writes into a folder."""
    with tempfile.TemporaryDirectory() as place:
        write(Path(place))
        paths = [path for path in Path(place).rglob("*") if path.is_file()]
        return {path.relative_to(place).as_posix(): path.read_bytes() for path in paths}


@cache
def good(kind: str) -> tuple[Files, str]:
    """A good file of a format, and its mapping."""
    made: list[str] = []
    write: Mapping[str, Callable[[Path, Log], str]] = FORMATS | {
        "v2.1": lambda place, log: lerobot(place, log, "v2.1", 3),
        "v3.0": lambda place, log: lerobot(place, log, "v3.0", 2),
        "bag folder": lambda place, log: _bag(place / "log", log, StoragePlugin.SQLITE3),
    }
    files = files_of(lambda place: made.append(write[kind](place, some_log())))
    return files, made[0]


INFOS: tuple[tuple[str, Any], ...] = (
    ("data_path", "../../../etc/passwd"), ("data_path", "/dev/zero"), ("data_path", {}),
    ("data_path", "{episode_index.__class__.__mro__}"), ("data_path", "data/{x:99999999999d}"),
    ("fps", float("nan")), ("fps", -1), ("fps", 1e300), ("fps", "30"), ("fps", True),
    ("fps", 10**400), ("codebase_version", "v9"), ("codebase_version", ["v3.0"]),
    ("codebase_version", "\x1b[31mv3"), ("features", []), ("features", "x" * 10**6),
    ("features", {"observation.state": None}), ("features", {"../../x": {"shape": [2]}}),
    ("total_episodes", 10**18), ("total_frames", -1), ("chunks_size", 0),
)  # fmt: skip
"""Keys of `meta/info.json` and what they say."""

ABOUT: tuple[tuple[str, Any], ...] = (
    ("shape", [10**12]), ("shape", [-2]), ("shape", [2.0]), ("shape", "2"), ("shape", []),
    ("shape", [3]), ("dtype", "object"), ("dtype", "float32" + "0" * 10**5), ("dtype", 7),
    ("names", 7), ("names", ["a", "a"]), ("names", ["../a", "/b"]), ("names", [None, {}]),
    ("names", {"a": {"b": []}}), ("names", ["\x1b[2J", "\u202eb"]),
    ("names", ["x" * 10**6, "y"]), ("names", ["timestamp", "__class__"]), ("names", ["a\nb", "\0"]),
)  # fmt: skip
"""Keys of a feature and what they say."""


def _info(draw: DrawFn, files: Files) -> Files:
    """What the dataset says of itself, otherwise."""
    content = json.loads(files["log/meta/info.json"])
    for _ in range(draw(st.integers(1, 2))):
        if draw(st.booleans()):
            key, value = draw(st.sampled_from(INFOS))
            content[key] = value
        elif isinstance(content.get("features"), dict) and content["features"]:
            feature = draw(st.sampled_from(sorted(content["features"])))
            key, value = draw(st.sampled_from(ABOUT))
            if isinstance(content["features"][feature], dict):
                content["features"][feature][key] = value
    return files | {"log/meta/info.json": json.dumps(content).encode()}


def _missing(draw: DrawFn, files: Files) -> Files:
    """Files that are not there, or are of something else."""
    name = draw(st.sampled_from(sorted(files)))
    rest = {each: data for each, data in files.items() if each != name}
    junk = draw(
        st.sampled_from([b"", b"PAR1", b"{", b"[" * 10**5, b"null", b"\xff\xfe" * 9, b"0" * 10**6])
    )
    return rest | draw(
        st.sampled_from([{}, {name: junk}, {f"{name}/x": junk}, {name + ".part": junk}])
    )


def _columns(draw: DrawFn, files: Files) -> Files:
    """A Parquet file of another table."""
    name = draw(st.sampled_from(sorted(name for name in files if name.endswith(".parquet"))))
    return files | {name: draw(changed(files[name]))}


@st.composite
def changed_dataset(draw: DrawFn, files: Files) -> Files:
    """A dataset after one or two changes."""
    for _ in range(draw(st.integers(1, 2))):
        change = draw(st.sampled_from([_info, _info, _columns, _columns, _missing]))
        if "log/meta/info.json" in files and any(name.endswith(".parquet") for name in files):
            try:
                files = change(draw, files)
            except (pa.ArrowException, ValueError, TypeError, RecursionError, OSError):
                continue  # the change before has left nothing to change
    return files


def _mcap(
    write: Callable[[Writer], None], compression: CompressionType = CompressionType.NONE,
    **options: Any,
) -> Files:  # fmt: skip
    """A file of records."""
    sink = io.BytesIO()
    writer = Writer(sink, compression=compression, enable_crcs=False, **options)
    writer.start()
    write(writer)
    writer.finish()  # type: ignore[no-untyped-call]
    return {"log.mcap": sink.getvalue()}


def _messages(encoding: str, name: str, schema: bytes, messages: list[bytes]) -> Files:
    """A topic of messages, the first alike."""

    def write(writer: Writer) -> None:
        kind = writer.register_schema(name, {"json": "jsonschema"}.get(encoding, encoding), schema)
        channel = writer.register_channel("/joint_states", encoding, kind)
        for k, data in enumerate(messages):
            writer.add_message(channel, k * 10**7, data, k * 10**7)

    return _mcap(write)


def _described(
    change: Callable[[FileDescriptorSet], Any],
    name: str = "foxglove.Plate",
    message: bytes = b"\x12\x08" + bytes(8),
) -> Files:
    """Messages of a schema that is changed."""
    schema = protobuf_schema()
    change(schema)
    return _messages("protobuf", name, schema.SerializeToString(), [message] * 5)


def _recursive(schema: FileDescriptorSet) -> None:
    schema.file[1].message_type[2].field.add(
        name="again", number=3, type=FieldDescriptorProto.TYPE_MESSAGE, label=1,
        type_name=".foxglove.Plate",
    )  # fmt: skip


def _nested(depth: int) -> bytes:
    """A message in a message in a message, of `_recursive`."""
    data = b""
    for _ in range(depth):
        size, length = b"", len(data)
        while length > 127:
            size, length = size + bytes([length & 127 | 128]), length >> 7
        data = b"\x1a" + size + bytes([length]) + data
    return data


def _bomb(size: int, compression: CompressionType) -> Files:
    """A chunk of zeros."""

    def write(writer: Writer) -> None:
        channel = writer.register_channel("/joint_states", "json", 0)
        for k in range(5):
            writer.add_message(channel, k, b'{"a":1}' + b" " * (size // 5), k)

    return _mcap(write, compression, chunk_size=2 * size)


def _topics(writer: Writer) -> None:
    """Topics without a message."""
    for k in range(20_000):
        writer.register_channel(f"/{k}", "json", 0)


def _lied(offset: int, value: int) -> Files:
    """A chunk that says something else of itself: at 16 its size unpacked, at 37 its length."""
    data = bytearray(_bomb(10_000, CompressionType.ZSTD)["log.mcap"])
    place = 8
    while data[place] != 6:
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    data[place + 9 + offset : place + 17 + offset] = value.to_bytes(8, "little")
    return {"log.mcap": bytes(data)}


def _rrd(log: Callable[[rr.RecordingStream], None]) -> Files:
    """What is logged."""

    def write(place: Path) -> None:
        stream = rr.RecordingStream("log", recording_id="log")
        stream.save(place / "log.rrd")
        log(stream)
        stream.flush()
        stream.disconnect()

    return files_of(write)


def _steps(values: Callable[[int], Any], entity: str = "position/j1", count: int = 20) -> Files:
    def log(stream: rr.RecordingStream) -> None:
        for k in range(count):
            stream.set_time("t", duration=k * 0.01)
            stream.log(entity, rr.Scalars(values(k)))

    return _rrd(log)


def _static(stream: rr.RecordingStream) -> None:
    stream.log("position/j1", rr.Scalars(1.0), static=True)


def _words(stream: rr.RecordingStream) -> None:
    for k in range(9):
        stream.set_time("step", sequence=k)
        stream.log("notes", rr.TextLog("\x1b[31m" * k))
        stream.log("cloud", rr.Points3D(np.zeros((k, 3))))
        stream.log("picture", rr.Image(np.zeros((9, 9, 3), np.uint8)))


def _h5(*arrays: Any) -> Files:
    """An ALOHA file of these."""

    def write(place: Path) -> None:
        with h5py.File(place / "log.h5", "w") as file:
            for name, values in zip(ALOHA, arrays, strict=True):
                file.create_dataset(f"observations/{name}", data=values)

    return files_of(write)


def _jsons(*texts: str) -> Files:
    return _messages("json", "x", b"{}", [text.encode() for text in texts])


def _fields(schema: FileDescriptorSet) -> Any:
    return schema.file[1].message_type[2].field


FEW, ALOHA = np.zeros((9, 3)), ("qpos", "qvel", "effort")
DEEP = "[" * 100_000 + "]" * 100_000
DESCRIBED: dict[str, Callable[[FileDescriptorSet], Any]] = {
    "a type in itself": _recursive,
    "no types": lambda schema: schema.Clear(),
    "needs itself": lambda schema: schema.file[1].dependency.append("foxglove/JointStates.proto"),
    "needs others": lambda schema: schema.file[1].dependency.append("../../etc/passwd"),
    "3000 files in a row": lambda schema: [
        schema.file.add(name=f"f{k}.proto", dependency=[f"f{k + 1}.proto"]) for k in range(3000)
    ],
    "20000 types": lambda schema: [
        schema.file[1].message_type.add(name=f"M{k}") for k in range(20_000)
    ],
    "the same twice": lambda schema: schema.file.add().CopyFrom(schema.file[1]),
    "a field named as a method": lambda schema: setattr(_fields(schema)[1], "name", "__class__"),
    "one number twice": lambda schema: setattr(_fields(schema)[0], "number", 2),
}
"""What is changed in a schema of protobuf."""

ARRAYS: dict[str, tuple[Any, Any, Any]] = {
    "texts": (np.array([[b"a"] * 3] * 9), FEW, FEW),
    "volumes": (np.zeros((9, 3, 3)), FEW, FEW),
    "other lengths": (FEW, FEW[:7], FEW[:8, :2]),
    "not numbers": (FEW * np.nan,) * 3,
    "two samples": (FEW[:2],) * 3,
    "complex": (FEW * 1j,) * 3,
    "whole and huge": (np.full((9, 3), 2**63 - 1),) * 3,
}
"""Of an ALOHA file."""

JSONS: dict[str, list[str]] = {
    "no object": ["3", "4", "5"],
    "deep": [DEEP, DEEP],
    "too many digits": [f'{{"a": {"9" * 5000}}}'] * 5,
    "above counters": [f'{{"a": {2**63 + k}, "q": 1}}' for k in range(9)],
    "not numbers": ['{"q": [NaN, Infinity], "t": NaN}'] * 5,
    "fields that change": ['{"a": 1}', '{"b": 1}', '{"a": 2}'],
    "lists that grow": [f'{{"q": {[1] * k}}}' for k in range(9)],
    "a list without end": [f'{{"q": {[0] * 300_000}}}', "{}"],
    "odd names": ['{"name": ["__class__", "../x"], "q": [1, 2]}'] * 9,
    "a terminal": ['{"\\u001b[2J\\u202e": 1, "q\\n": [2, 3]}'] * 9,
    "names alike": ['{"name": ["a", "a"], "position": [1, 2]}'] * 9,
    "a stamp of texts": ['{"t": {"sec": "1", "nsec": 2.5}, "q": 1}'] * 9,
    "a stamp of the year 10^300": [f'{{"t": {{"sec": 1{"0" * 300}, "nsec": 2}}}}'] * 9,
}
"""Messages."""

TRAPS: dict[str, Callable[[], Files]] = {
    **{f"json: {name}": partial(_jsons, *texts) for name, texts in JSONS.items()},
    **{f"protobuf: {name}": partial(_described, change) for name, change in DESCRIBED.items()},
    **{f"h5: {name}": partial(_h5, *arrays) for name, arrays in ARRAYS.items()},
    "json: no text": lambda: _messages("json", "x", b"", [b"\xff\xfe\0", b"\x80"]),
    "no encoding": lambda: _messages("", "x", b"", [b"1"]),
    "an encoding of pickles": lambda: _messages("pickle", "x", b"", [b"cos\nsystem\n(S'id'\ntR."]),
    "ros: a definition of itself": lambda: _messages("cdr", "x/msg/Y", b"x/Y y\n", [bytes(40)] * 5),
    "ros: a definition of words": lambda: _messages("cdr", "x/msg/Y", b"\xff((", [bytes(9)] * 5),
    "ros 1: short": lambda: _messages("ros1", "std_msgs/Float64", b"float64 data", [b"12"] * 5),
    "protobuf: 5000 deep": lambda: _described(_recursive, message=_nested(5000)),
    "protobuf: no such type": lambda: _described(lambda _: None, "foxglove.Nothing"),
    "protobuf: a schema of noise": lambda: _messages("protobuf", "x", b"\x0a\xff\xff" * 9, [b""]),
    "protobuf: messages of noise": lambda: _described(lambda _: None, message=b"\xff" * 99),
    "protobuf: any content": lambda: _messages(
        "protobuf", "google.protobuf.Struct",
        FileDescriptorSet(file=[_copied(struct_pb2.DESCRIPTOR)]).SerializeToString(),
        [b"\x0a\x05\x0a\x01a\x12\x00"] * 5,
    ),
    "zstd: 200 MB of blanks": lambda: _bomb(200_000_000, CompressionType.ZSTD),
    "lz4: 200 MB of blanks": lambda: _bomb(200_000_000, CompressionType.LZ4),
    "a chunk of 2^50 bytes": lambda: _lied(16, 2**50),
    "a chunk of no bytes": lambda: _lied(16, 0),
    "a packed length of 2^60": lambda: _lied(32, 2**60),
    "20000 topics": lambda: _mcap(_topics),
    "rrd: not numbers": lambda: _steps(lambda _: np.nan),
    "rrd: lists that grow": lambda: _steps(lambda k: [1.0] * (k + 1)),
    "rrd: an entity of a terminal": lambda: _steps(float, "\x1b[2J/\u202ex"),
    "rrd: an entity of dots": lambda: _steps(float, "../../etc"),
    "rrd: one sample": lambda: _steps(float, count=1),
    "rrd: static": lambda: _rrd(_static),
    "rrd: nothing": lambda: _rrd(lambda _: None),
    "rrd: words and pictures": lambda: _rrd(_words),
}  # fmt: skip
"""Small files that would harm a reader."""


def _copied(descriptor: Any) -> FileDescriptorProto:
    made = FileDescriptorProto()
    descriptor.CopyToProto(made)
    return made


def mapping_of(name: str) -> str:
    """A mapping that reads what a trap may hold."""
    topics = {"mcap": 'topic = "/joint_states"', "rrd": 'topic = "position/j1"'}
    topic = topics.get(name.rpartition(".")[2], "")
    return (
        f'rate = 100\njoints = ["j1"]\n[sources.log]\nfile = "{name}"\n{topic}\nrate = 100\n'
        '[position]\nsource = "log"\ncolumns = ["q"]\nunit = "rad"\n'
        '[torque]\nsource = "log"\ncolumns = ["a"]\nunit = "N m"\n'
    )
