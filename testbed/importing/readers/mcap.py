"""MCAP files: messages in JSON, Protobuf and of ROS 1 and 2 are numbers by their paths.

Messages are decoded by the schemas in the file.

Source    The MCAP format specification, mcap.dev/spec
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
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
from testbed.importing.readers.message_rows import MessageRows, numbers_of
from testbed.importing.readers.ros_bag import Decoder, decoder_of

MOST_BYTES = 250_000_000
"""Of a record."""

TIMES = ("google.protobuf.Timestamp", "google.protobuf.Duration")


def tables(path: Path, topic: str | None) -> Tables:
    """Every topic, or one.

    Args:
        path: The file.
        topic: The only one that is wanted; None for all.

    Raises:
        RecordingError: The file is damaged, or mcap is not installed.
        UnknownName: There is no such topic.
    """
    with library("mcap"):
        from mcap.stream_reader import StreamReader
    with readable(path), path.open("rb") as stream:
        reader = StreamReader(stream, validate_crcs=True, record_size_limit=MOST_BYTES)
        return _tables(path, reader.records, topic)


def _tables(path: Path, records: Iterable[Any], wanted: str | None) -> Tables:
    """One topic or all of them, in one pass."""
    known: dict[str, dict[int, Any]] = {"Schema": {}, "Channel": {}}
    decoders: dict[int, Decoder] = {}
    rows: dict[str, MessageRows] = {}
    failed: Tables = {}
    count = 0
    for record in records:
        if (kind := type(record).__name__) in known:
            known[kind][record.id] = record
        if kind != "Message":
            continue
        channel = known["Channel"][record.channel_id]
        if wanted not in (None, channel.topic) or channel.topic in failed:
            continue
        try:
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(
                    channel, known["Schema"].get(channel.schema_id)
                )
            numbers = decoders[channel.id](record.data)
            rows.setdefault(channel.topic, MessageRows(path)).add(
                record.log_time, numbers
            )
        except Exception as error:  # whatever a damaged message makes a library raise
            failed[channel.topic] = refusal(path, error)
            rows.pop(channel.topic, None)
            continue
        count += len(numbers) + 1
        check_count(path, "numbers", count, MOST_NUMBERS)
    topics = dict.fromkeys(each.topic for each in known["Channel"].values())
    if wanted is not None and wanted not in topics:
        raise UnknownName("topic", wanted, sorted(topics))
    empty = {topic: MessageRows(path) for topic in topics if wanted in (None, topic)}
    return {topic: each.table() for topic, each in (empty | rows).items()} | failed


def _decoder(channel: Any, schema: Any) -> Decoder:
    """What decodes a channel's messages."""
    if channel.message_encoding not in DECODERS:
        raise UnknownName("encoding of messages", channel.message_encoding, DECODERS)
    return DECODERS[channel.message_encoding](schema)


def _json(_schema: Any) -> Decoder:
    """Of JSON, which needs no schema."""
    return lambda data: numbers_of(json.loads(data))


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
    return lambda data: numbers_of(_content(made.FromString(data)))


def _content(message: Any) -> dict[str, Any]:
    """A Protobuf message as JSON has it; numbers that are not sent are zero, as they are there."""
    if message.DESCRIPTOR.full_name in TIMES:
        return {"sec": message.seconds, "nsec": message.nanos}
    sent = {field.name for field, _ in message.ListFields()}
    found: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        if field.name not in sent and (field.is_repeated or field.has_presence):
            continue
        value, inner = getattr(message, field.name), field.message_type
        if inner is None:
            found[field.name] = [*value] if field.is_repeated else value
        elif not field.is_repeated:
            found[field.name] = _content(value)
        elif not inner.GetOptions().map_entry:
            found[field.name] = [_content(each) for each in value]
    return found


def _ros(version: int) -> Callable[[Any], Decoder]:
    """Of ROS 1 or 2."""

    def decoder(schema: Any) -> Decoder:
        idl = schema.encoding.endswith("idl")
        return decoder_of(schema.name, schema.data.decode(), version, idl=idl)

    return decoder


DECODERS: dict[str, Callable[[Any], Decoder]] = {
    "json": _json,
    "protobuf": _protobuf,
    "cdr": _ros(2),
    "ros1": _ros(1),
}
"""By a channel's encoding: of a schema, what decodes its messages."""
