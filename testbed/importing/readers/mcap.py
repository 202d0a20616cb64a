"""MCAP files: numbers in messages of JSON, Protobuf, ROS 1 and ROS 2.

A column is named by the path of its number in the message. Messages are decoded according to the
schemas in the file.

Source    The MCAP format specification, mcap.dev/spec
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from testbed.core.base.errors import UnknownName
from testbed.importing.foreign_table import (
    MAX_NUMBERS,
    TablesByTopic,
    check_count,
    optional_package,
    reading_error,
    reading_errors_as_recording_errors,
)
from testbed.importing.readers.message_rows import MessageTableBuilder, message_numbers
from testbed.importing.readers.ros_bag import MessageDecoder, ros_message_decoder

MAX_RECORD_BYTES = 250_000_000
"""Largest size of a record [bytes]."""

PROTOBUF_TIME_TYPES = ("google.protobuf.Timestamp", "google.protobuf.Duration")
"""Protobuf messages that are times."""


def tables(path: Path, topic: str | None) -> TablesByTopic:
    """Tables of a file's topics, with one row for each message.

    Args:
        path: Path of the file.
        topic: Topic of a single table; None for all tables.

    Raises:
        RecordingError: The file is damaged, or mcap is not installed.
        UnknownName: There is no such topic.
    """
    with optional_package("mcap"):
        from mcap.stream_reader import StreamReader
    with reading_errors_as_recording_errors(path), path.open("rb") as stream:
        reader = StreamReader(
            stream, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES
        )
        return _tables_by_topic(path, reader.records, topic)


def _tables_by_topic(
    path: Path, records: Iterable[Any], topic_name: str | None
) -> TablesByTopic:
    """Tables of a file's topics, from the records in one pass.

    If a message of a topic cannot be decoded, the topic has an error in place of its table.

    Raises:
        UnknownName: There is no such topic.
    """
    known: dict[str, dict[int, Any]] = {"Schema": {}, "Channel": {}}
    decoders: dict[int, MessageDecoder] = {}
    rows: dict[str, MessageTableBuilder] = {}
    errors: TablesByTopic = {}
    count = 0
    for record in records:
        if (kind := type(record).__name__) in known:
            known[kind][record.id] = record
        if kind != "Message":
            continue
        channel = known["Channel"][record.channel_id]
        if topic_name not in (None, channel.topic) or channel.topic in errors:
            continue
        try:
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(
                    channel, known["Schema"].get(channel.schema_id)
                )
            numbers = decoders[channel.id](record.data)
            rows.setdefault(channel.topic, MessageTableBuilder(path)).add_message(
                record.log_time, numbers
            )
        except Exception as error:  # damaged messages cause exceptions of any type
            errors[channel.topic] = reading_error(path, error)
            rows.pop(channel.topic, None)
            continue
        count += len(numbers) + 1
        check_count(path, "numbers", count, MAX_NUMBERS)
    topics = dict.fromkeys(each.topic for each in known["Channel"].values())
    if topic_name is not None and topic_name not in topics:
        raise UnknownName("topic", topic_name, sorted(topics))
    empty = {
        topic: MessageTableBuilder(path)
        for topic in topics
        if topic_name in (None, topic)
    }
    return {topic: each.table() for topic, each in (empty | rows).items()} | errors


def _decoder(channel: Any, schema: Any) -> MessageDecoder:
    """Decoder for the messages of a channel.

    Raises:
        UnknownName: The encoding of the messages is not known.
    """
    if channel.message_encoding not in DECODER_OF_ENCODING:
        raise UnknownName(
            "encoding of messages", channel.message_encoding, DECODER_OF_ENCODING
        )
    return DECODER_OF_ENCODING[channel.message_encoding](schema)


def _json_decoder(_schema: Any) -> MessageDecoder:
    """Decoder for messages in JSON, which needs no schema."""
    return lambda data: message_numbers(json.loads(data))


def _protobuf_decoder(schema: Any) -> MessageDecoder:
    """Decoder for Protobuf messages, from the file descriptors in the schema."""
    with optional_package("protobuf"):
        from google.protobuf.descriptor_pb2 import FileDescriptorSet
        from google.protobuf.descriptor_pool import DescriptorPool
        from google.protobuf.message_factory import GetMessageClass
    files = {file.name: file for file in FileDescriptorSet.FromString(schema.data).file}
    pool = DescriptorPool()

    def add(name: str) -> None:
        if (file := files.pop(name, None)) is not None:
            for dependency in file.dependency:
                add(dependency)
            pool.Add(file)

    for name in [*files]:
        add(name)
    message_class = GetMessageClass(pool.FindMessageTypeByName(schema.name))
    return lambda data: message_numbers(_message_fields(message_class.FromString(data)))


def _message_fields(message: Any) -> dict[str, Any]:
    """Fields of a Protobuf message, in the form of parsed JSON.

    Omitted numbers are zero, the default of Protobuf.
    """
    if message.DESCRIPTOR.full_name in PROTOBUF_TIME_TYPES:
        return {"sec": message.seconds, "nsec": message.nanos}
    set_fields = {field.name for field, _ in message.ListFields()}
    fields: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        if field.name not in set_fields and (field.is_repeated or field.has_presence):
            continue
        value, inner = getattr(message, field.name), field.message_type
        if inner is None:
            fields[field.name] = [*value] if field.is_repeated else value
        elif not field.is_repeated:
            fields[field.name] = _message_fields(value)
        elif not inner.GetOptions().map_entry:
            fields[field.name] = [_message_fields(each) for each in value]
    return fields


def _ros_decoder(version: int) -> Callable[[Any], MessageDecoder]:
    """Function that creates decoders for messages of ROS 1 or 2 from a schema.

    Args:
        version: Version of ROS, 1 or 2.
    """

    def decoder(schema: Any) -> MessageDecoder:
        idl = schema.encoding.endswith("idl")
        return ros_message_decoder(schema.name, schema.data.decode(), version, idl=idl)

    return decoder


DECODER_OF_ENCODING: dict[str, Callable[[Any], MessageDecoder]] = {
    "json": _json_decoder,
    "protobuf": _protobuf_decoder,
    "cdr": _ros_decoder(2),
    "ros1": _ros_decoder(1),
}
"""Functions that make a decoder from a schema, by encoding of the channel."""
