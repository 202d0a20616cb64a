"""Channels that are spoiled are told by name, before units, signs and orders are doubted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.inverse_recordings import RATE, truth
from testbed.recordings.recording import Recording
from testbed.sanity.sanity import check_sanity
from tests.helpers.measured import measured
from tests.helpers.runs import robot, without

TREE = robot("ur5")
RIGHT = measured(TREE, 4, duration=8.0)


@pytest.mark.parametrize("size", [10.0, 1e4])
@pytest.mark.parametrize("signal", ["position", "torque", "wrench"])
def test_a_spike_is_told_with_its_channel_and_instant(signal: str, size: float) -> None:
    values = np.array(RIGHT.measured(signal))
    values[700, 2] += size * np.ptp(values[:, 2])
    spoiled: dict[str, Any] = {signal: values}
    found = check_sanity(TREE, replace(RIGHT, **spoiled))
    (said,) = found.certain
    assert said.causes == ("spikes",)
    assert ("Fz" if signal == "wrench" else TREE.names[2]) in said.subject
    assert f"at {RIGHT.time[700]:.6g} s" in said.found
    assert found.cures == ()


@pytest.mark.parametrize("joint", [0, 2, 5])
@pytest.mark.parametrize("plate", [True, False])
def test_a_dead_encoder_is_told_by_name_and_cured_by_no_sign(joint: int, plate: bool) -> None:
    position = np.array(RIGHT.position)
    position[:, joint] = 0.0
    read = replace(RIGHT, position=position)
    found = check_sanity(TREE, read if plate else without(read, "wrench"))
    (said,) = (*found.certain, *found.likely)
    assert said.causes[said.causes[0] == "a joint at rest"] == "a dead encoder"
    assert TREE.names[joint] in said.subject
    assert found.cures == ()


def test_a_joint_that_rests_indeed_is_none_with_a_dead_encoder() -> None:
    """Held by its drive: its torque and the plate's wrench are those of a joint at rest."""
    made = truth("ur5", 1, seconds=8.0, moving=(0, 1, 2, 4, 5))
    recording = Recording(
        made.tree.names, np.arange(len(made.position)) / RATE, made.position,
        torque=made.torque, wrench=made.wrench, tare=np.zeros(6),
    )  # fmt: skip
    found = check_sanity(made.tree, recording)
    assert (found.certain, found.cures) == ((), ())
    assert [each.causes[0] for each in found.likely] == ["a joint at rest"]
