"""Messages of ROS that hold lists of messages, texts, and odd lengths: numbers by their paths."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from testbed.errors import RecordingError
from testbed.recordings.importing.readers import open_foreign
from testbed.recordings.importing.readers.ros_messages import numbers_of
from tests.helpers.foreign_files import EPOCH

POLYGON, DIAGNOSTIC = "geometry_msgs/msg/Polygon", "diagnostic_msgs/msg/DiagnosticStatus"
VERSIONS = {1: Stores.ROS1_NOETIC, 2: Stores.ROS2_HUMBLE}


def store_of(version: int) -> Any:
    return get_typestore(VERSIONS[version])


def packed(version: int, kind: str, message: Any) -> bytes:
    store = store_of(version)
    pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
    return bytes(pack(message, kind))


def polygon(version: int, points: np.ndarray[Any, Any]) -> bytes:
    kinds = store_of(version).types
    each = [kinds["geometry_msgs/msg/Point32"](*map(float, point)) for point in points]
    return packed(version, POLYGON, kinds[POLYGON](each))


def bag(path: Path, version: int, kind: str, messages: list[bytes]) -> None:
    writer: Any = (
        Writer1(path)
        if version == 1
        else Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    )
    with writer:
        topic = writer.add_connection("/told", kind, typestore=store_of(version))
        for k, message in enumerate(messages):
            writer.write(topic, EPOCH + k * 10_000_000, message)


@pytest.mark.parametrize("version", VERSIONS)
def test_lists_of_messages_are_numbers_by_their_places(version: int, tmp_path: Path) -> None:
    points = np.random.default_rng(version).normal(size=(5, 3, 3)).astype(np.float32)
    path = tmp_path / ("log.bag" if version == 1 else "log")
    bag(path, version, POLYGON, [polygon(version, each) for each in points])
    table = open_foreign(path, "/told")
    names = [f"points[{k}]/{axis}" for k in range(3) for axis in "xyz"]
    found = table.read(names)
    for name, values in zip(names, points.reshape(5, 9).T, strict=True):
        np.testing.assert_array_equal(found[name], values)
    assert set(names) < set(table.columns)


@pytest.mark.parametrize("version", VERSIONS)
def test_messages_whose_lists_grow_are_of_no_table(version: int, tmp_path: Path) -> None:
    path = tmp_path / ("log.bag" if version == 1 else "log")
    bag(path, version, POLYGON, [polygon(version, np.ones((k, 3))) for k in (2, 2, 3)])
    with pytest.raises(RecordingError, match=r"have different fields \(points\[2\]/x, points\[2\]"):
        open_foreign(path, "/told")


@pytest.mark.parametrize("version", VERSIONS)
def test_texts_between_numbers_are_passed_over(version: int) -> None:
    store = store_of(version)
    pair = store.types["diagnostic_msgs/msg/KeyValue"]
    values = [pair("temperature", "41.5"), pair("größe", "")]
    message = store.types[DIAGNOSTIC](2, "plate", "warm", "id 7", values)
    data = packed(version, DIAGNOSTIC, message)
    found = numbers_of(data, DIAGNOSTIC, store.fielddefs, version)
    assert found == {"level": 2.0}


@pytest.mark.parametrize("version", VERSIONS)
def test_a_list_that_is_longer_than_its_message_is_damage(version: int) -> None:
    definitions = store_of(version).fielddefs
    data = polygon(version, np.ones((2, 3)))
    start = 0 if version == 1 else 4
    for count, said in ((10**6, "longer than the message"), (3, "ends early")):
        wrong = data[:start] + count.to_bytes(4, "little") + data[start + 4 :]
        with pytest.raises(ValueError, match=said):
            numbers_of(wrong, POLYGON, definitions, version)
    fewer = data[:start] + (1).to_bytes(4, "little") + data[start + 4 :]
    assert len(numbers_of(fewer, POLYGON, definitions, version)) == 3
