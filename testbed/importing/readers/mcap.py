"""MCAP files: messages in JSON, Protobuf and of ROS 1 and 2 are numbers by their paths.

Messages are decoded by the schemas in the file; none of its names becomes code.

Source    The MCAP format specification, mcap.dev/spec
"""

from __future__ import annotations

import io
import json
import mmap
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from testbed.core.base.errors import UnknownName
from testbed.importing.foreign_table import (
    MOST_NUMBERS,
    Tables,
    check_count,
    library,
    readable,
    refusal,
)
from testbed.importing.readers.ros_bag import (
    LISTS_OF_NAMES,
    MOST_STEPS,
    Nanoseconds,
    Numbers,
    Rows,
    definitions_of,
    numbers_of,
)

MOST_BYTES = 250_000_000
"""Of a record, and of a chunk, unpacked."""

MOST_PACKED = 500
"""Bytes that one packed byte may be: robots' messages are some tens."""

SECONDS = (("sec", "nsec"), ("sec", "nanosec"), ("secs", "nsecs"), ("seconds", "nanos"))
"""Keys of a time: whole seconds, and nanoseconds."""

TIMES = ("google.protobuf.Timestamp", "google.protobuf.Duration")

Decoder = Callable[[bytes], Numbers]
"""Numbers of a message by their paths."""


def tables(path: Path, topic: str | None) -> Tables:
    """Every topic, or one.

    Args:
        path: The file.
        topic: The only one that is wanted; None for all.

    Raises:
        RecordingError: The file is damaged, or mcap is not installed.
        UnknownName: There is no such topic.
    """
    with readable(path):
        return _tables(path, topic)


def _tables(path: Path, wanted: str | None) -> Tables:
    """One topic or all of them, in one pass."""
    known: dict[str, dict[int, Any]] = {"Schema": {}, "Channel": {}}
    decoders: dict[int, Decoder] = {}
    rows: dict[str, Rows] = {}
    failed: Tables = {}
    count = 0
    for record in _records(path):
        if (kind := type(record).__name__) in known:
            known[kind][record.id] = record
        if kind != "Message":
            continue
        channel = known["Channel"][record.channel_id]
        if wanted not in (None, channel.topic) or channel.topic in failed:
            continue
        try:
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(channel, known["Schema"].get(channel.schema_id))
            numbers = decoders[channel.id](record.data)
            rows.setdefault(channel.topic, Rows(path)).add(record.log_time, numbers)
        except Exception as error:  # whatever a damaged message makes a library raise
            failed[channel.topic] = refusal(path, error)
            rows.pop(channel.topic, None)
            continue
        count += len(numbers) + 1
        check_count(path, "numbers", count, MOST_NUMBERS)
    topics = dict.fromkeys(each.topic for each in known["Channel"].values())
    if wanted is not None and wanted not in topics:
        raise UnknownName("topic", wanted, sorted(topics))
    empty = {topic: Rows(path) for topic in topics if wanted in (None, topic)}
    return {topic: each.table() for topic, each in (empty | rows).items()} | failed


def _decoder(channel: Any, schema: Any) -> Decoder:
    """What decodes a channel's messages."""
    if channel.message_encoding not in DECODERS:
        raise UnknownName("encoding of messages", channel.message_encoding, DECODERS)
    return DECODERS[channel.message_encoding](schema)


def _records(path: Path) -> Iterator[Any]:
    """Records of a file, those in chunks with the others."""
    with library("mcap"):
        from mcap.stream_reader import StreamReader, breakup_chunk
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        reader: Any = StreamReader(data, emit_chunks=True, record_size_limit=MOST_BYTES)  # type: ignore[arg-type]
        for record in reader.records:
            if type(record).__name__ == "Chunk":
                yield from breakup_chunk(replace(record, compression="", data=_unpacked(record)))
            else:
                yield record


def _unpacked(chunk: Any) -> bytes:
    """A chunk's records, as many bytes as it says."""
    size, packed = int(chunk.uncompressed_size), len(chunk.data)
    if size > min(MOST_BYTES, MOST_PACKED * packed):
        raise ValueError(f"a chunk of {packed} bytes would be {size:.2g}")
    if chunk.compression == "zstd":
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(io.BytesIO(chunk.data)) as stream:
            found = bytes(stream.read(size + 1))
    elif chunk.compression == "lz4":
        import lz4.frame

        found = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    else:
        found = chunk.data
    if len(found) != size or chunk.uncompressed_crc not in (0, zlib.crc32(found)):
        raise ValueError("a chunk is not what the file says of it")
    return found


def _json(_schema: Any) -> Decoder:
    """Of JSON, which needs no schema."""
    return lambda data: _numbers(json.loads(data))


def _protobuf(schema: Any) -> Decoder:
    """Of Protobuf, by the descriptors that are the schema."""
    with library("protobuf"):
        from google.protobuf.descriptor_pb2 import FileDescriptorSet
        from google.protobuf.descriptor_pool import DescriptorPool
        from google.protobuf.message_factory import GetMessageClass
    files = {file.name: file for file in FileDescriptorSet.FromString(schema.data).file}
    pool = DescriptorPool()

    def add(name: str) -> None:
        if (file := files.pop(name, None)) is not None:
            for needed in file.dependency:
                add(needed)
            pool.Add(file)

    for name in [*files]:
        add(name)
    made = GetMessageClass(pool.FindMessageTypeByName(schema.name))
    return lambda data: _numbers(_content(made.FromString(data)))


def _content(message: Any) -> dict[str, Any]:
    """A Protobuf message as JSON has it; numbers that are not sent are zero, as they are there."""
    sent = {field.name: value for field, value in message.ListFields()}
    if message.DESCRIPTOR.full_name in TIMES:
        return {"sec": sent.get("seconds", 0), "nsec": sent.get("nanos", 0)}
    found: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        inner = field.message_type
        if field.name not in sent:
            if not (field.is_repeated or field.has_presence):
                found[field.name] = field.default_value
        elif inner is None:
            found[field.name] = [*sent[field.name]] if field.is_repeated else sent[field.name]
        elif not field.is_repeated:
            found[field.name] = _content(sent[field.name])
        elif not inner.GetOptions().map_entry:
            found[field.name] = [_content(each) for each in sent[field.name]]
    return found


def _ros(version: int) -> Callable[[Any], Decoder]:
    """Of ROS 1 or 2."""

    def decoder(schema: Any) -> Decoder:
        idl, text = schema.encoding.endswith("idl"), schema.data.decode()
        kind, known = definitions_of(schema.name, text, version, idl=idl)
        return lambda data: numbers_of(data, kind, known, version)

    return decoder


DECODERS: dict[str, Callable[[Any], Decoder]] = {
    "json": _json, "protobuf": _protobuf, "cdr": _ros(2), "ros1": _ros(1),
}  # fmt: skip
"""By a channel's encoding: of a schema, what decodes its messages."""


def _numbers(content: Any) -> Numbers:
    """All numbers of a message by path, as position/elbow, joints/elbow/effort, wrench[2]."""
    found: dict[str, float] = {}
    for path, number in _walk(content, "", ()):
        found[path] = number
        if len(found) > MOST_STEPS:
            raise ValueError("a message has too many parts")
    return found


def _walk(content: Any, path: str, names: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    if isinstance(content, dict):
        for keys in SECONDS:
            second, rest = (content.get(key) for key in keys)
            if isinstance(second, int) and isinstance(rest, int):
                yield path or "time", Nanoseconds(second * 1_000_000_000 + rest)
                return
        lists = (_texts(content.get(key)) for key in LISTS_OF_NAMES)
        own = next((each for each in lists if each), ())
        for key, value in content.items():
            yield from _walk(value, f"{path}/{key}" if path else str(key), own)
    elif isinstance(content, list):
        own = _texts([each.get("name") if isinstance(each, dict) else None for each in content])
        label = next((each for each in (own, names) if len(each) == len(content) > 0), None)
        for k, value in enumerate(content):
            yield from _walk(value, f"{path}/{label[k]}" if label else f"{path}[{k}]", ())
    elif isinstance(content, int | float):
        yield path, content


def _texts(value: Any) -> tuple[str, ...]:
    """A list of texts that are not alike; else nothing."""
    texts = (
        value if isinstance(value, list) and all(isinstance(each, str) for each in value) else []
    )
    return tuple(texts) if len(set(texts)) == len(texts) else ()
