"""A base that was measured is six joints more, in memory and in a file alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError
from testbed.recordings.measured_base import (
    NAMES,
    MeasuredBase,
    on_its_base,
    with_base_joints,
)
from testbed.recordings.source import open_source, segments_of
from testbed.robot.free_base import on_free_base
from tests.helpers.humanoid import humanoid
from tests.helpers.ideal import ideal
from tests.helpers.runs import robot


def test_a_file_is_taken_part_by_part_as_the_whole(tmp_path: Path) -> None:
    tree, recording = humanoid(3.0, 100.0, 1, 0.1)
    recording.save(tmp_path / "r.parquet")
    stored = open_source(tmp_path / "r.parquet")
    source, whole = on_its_base(stored, on_free_base(tree)), with_base_joints(recording)
    assert isinstance(source, MeasuredBase)
    assert source.names == whole.names == (*NAMES, *recording.names)
    assert (source.samples, source.rate) == (recording.samples, stored.rate)
    assert source.facts == whole.facts
    assert "geometry" not in source.facts
    assert set(source.signals) == {"time", "position", "wrench"}
    assert not source.senses_kinematics
    assert source.segments == segments_of(recording)
    for first, last in ((0, 100), (100, recording.samples)):
        part = source.part(first, last)
        assert (part.base, part.torque, part.truth) == (None, None, None)
        for name, values in part.columns().items():
            np.testing.assert_array_equal(values, whole.columns()[name][first:last])


def test_only_what_stands_on_a_moving_base_gets_its_joints() -> None:
    tree, recording = humanoid(1.0, 100.0, 1, 0.1)
    assert on_its_base(recording, tree) is recording
    free = on_free_base(tree)
    found = on_its_base(recording, free)
    assert found.names[:6] == NAMES
    assert on_its_base(found, free) is found


@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_without_a_base_it_is_said_what_is_lacking(name: str) -> None:
    recording = ideal(robot(name))
    with pytest.raises(RecordingError, match=r"has no base/x \.\.\. base/qz.*robot\.base"):
        MeasuredBase(recording)
    with pytest.raises(RecordingError):
        on_its_base(recording, on_free_base(robot(name)))
    with pytest.raises(tb.TestbedError):
        with_base_joints(recording)
