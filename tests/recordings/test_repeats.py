"""Poses that a slow device repeats: the true ones again; whatever else repeats stays as it is."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.recordings.repeats import without_repeated_poses
from testbed.core.recordings.source import open_source


def recording(position: Array) -> tb.Recording:
    time = np.arange(len(position)) / 100
    return tb.Recording(("a", "b"), time, position, torque=np.zeros_like(position))


def motion() -> Array:
    time = np.arange(3000)[:, None] / 100
    return np.sin([[2.0, 3.1]] * time + [[0.1, 0.7]])


@pytest.mark.parametrize("every", [2, 3])
def test_a_slow_device_costs_hardly_anything(every: int) -> None:
    """Repeated poses are late by up to its step, which looks like acceleration."""
    shown = np.repeat(motion()[::every], every, axis=0)[:3000]
    found, share = without_repeated_poses(open_source(recording(shown)))
    assert share == pytest.approx(1 - 1 / every, abs=1e-3)
    apart = found.part(0, found.samples).position - motion()[: found.samples]
    assert np.abs(apart).max() < 1e-3 * np.abs(shown - motion()).max()
    assert 3000 - found.samples < every


def test_steps_of_an_encoder_and_rests_are_no_slow_device() -> None:
    """Else coarse encoders would be taken for exact ones."""
    still = np.where(np.arange(3000)[:, None] % 500 < 250, motion(), motion()[:1])
    for other in (motion(), np.round(motion(), 2), np.round(0.1 * motion(), 3), still):
        source = open_source(recording(other))
        assert without_repeated_poses(source) == (source, 0.0)
