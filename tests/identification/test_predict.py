"""What an estimate predicts, from the motion that a recording shows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError
from testbed.identification.predict import motion_in
from testbed.recordings.recording import Recording
from tests.helpers.ideal import ideal
from tests.helpers.robots import random_robot


@pytest.fixture(scope="module")
def recording() -> Recording:
    return ideal(random_robot(np.random.default_rng(4), 3).tree(), duration=20.0)


def test_a_motion_that_was_sensed_is_taken_as_it_is(recording: Recording) -> None:
    motion, where = motion_in(recording)
    assert (where.start, where.stop) == (0, recording.samples)
    np.testing.assert_array_equal(motion.t, recording.time)
    for mine, theirs in (("q", "position"), ("qd", "velocity"), ("qdd", "acceleration")):
        np.testing.assert_array_equal(getattr(motion, mine), getattr(recording, theirs))


@pytest.mark.parametrize("missing", ["velocity", "acceleration"])
def test_a_motion_that_was_half_sensed_is_taken_from_the_encoders(
    missing: str, recording: Recording
) -> None:
    encoders = replace(recording, velocity=None, acceleration=None)
    whole, where = motion_in(encoders)
    lost: dict[str, Any] = {missing: None}
    motion, there = motion_in(replace(recording, **lost))
    assert there == where
    for name in ("t", "q", "qd", "qdd"):
        np.testing.assert_array_equal(getattr(motion, name), getattr(whole, name))


def test_the_filter_on_positions_gives_the_motion_within_its_ends(recording: Recording) -> None:
    """What is slow passes: values and derivatives are those of the motion, at their instants."""
    settings = tb.Settings(position_cutoff=40.0, cutoff=5.0)
    motion, where = motion_in(replace(recording, velocity=None, acceleration=None), settings)
    assert 0 < where.start == recording.samples - where.stop < recording.samples // 10
    np.testing.assert_array_equal(motion.t, recording.time[where])
    truth = recording.truth
    assert truth is not None
    np.testing.assert_allclose(motion.q, truth.position[where], atol=1e-6)
    np.testing.assert_allclose(motion.qd, truth.velocity[where], atol=1e-5)
    np.testing.assert_allclose(motion.qdd, truth.acceleration[where], atol=1e-4)


def test_a_recording_shorter_than_the_filter_is_refused(recording: Recording) -> None:
    encoders = replace(recording, velocity=None, acceleration=None)
    _, where = motion_in(encoders)
    shortest = encoders.part(0, 2 * where.start + 1)
    assert motion_in(shortest)[0].samples == 1
    with pytest.raises(RecordingError, match="too short"):
        motion_in(encoders.part(0, 2 * where.start))
