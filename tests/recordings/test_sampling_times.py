"""Positions show errors of their sampling times: a wrong time moves all joints along the motion."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.core.recordings.sampling_times import sampling_time_errors
from tests.helpers.measured import measured
from tests.helpers.runs import robot

CASES: tuple[dict[str, float], ...] = (
    {},
    {"speed": 0.2},
    {"noise": 10.0},
    {"duration": 5.0},
    {"rate": 30.0},
    {"rate": 1000.0},
)


@pytest.mark.parametrize("name", ["puma", "ur5", "gantry"])
@pytest.mark.parametrize("count", [0.0, 2e-4])
def test_nothing_is_found_in_even_recordings(name: str, count: float) -> None:
    """Slow or short ones, poor or coarse encoders, few samples and many."""
    for seed, case in enumerate(CASES):
        recording = measured(robot(name), 40 + seed, **{"duration": 10.0, **case})
        position = recording.position
        if count:
            position = count * np.round(position / count)
        assert sampling_time_errors(recording.time, position).is_free_of_errors


@pytest.mark.parametrize("sign", [1, -1])
def test_lost_and_repeated_rows_are_found_with_their_times(sign: int) -> None:
    recording = measured(robot("ur5"), 3)
    rows = np.array([400, 1200, 2500])
    changed = (
        np.delete(recording.position, rows, axis=0)
        if sign > 0
        else np.insert(recording.position, rows, recording.position[rows], axis=0)
    )
    time = recording.time[0] + np.arange(len(changed)) / recording.rate
    found = sampling_time_errors(time, changed)
    seen, none = (found.lost, found.repeated)[::sign]
    assert len(none) == 0
    np.testing.assert_allclose(seen, recording.time[rows], atol=0.03)


@pytest.mark.parametrize("size", [3e-4, 1e-3, 3e-3])
def test_jitter_is_found_with_its_size(size: float) -> None:
    recording = measured(robot("puma"), 4, noise=0.3)
    times = recording.time + size * np.random.default_rng(0).normal(size=recording.samples)
    moved = [np.interp(times, recording.time, q) for q in recording.position.T]
    found = sampling_time_errors(recording.time, np.stack(moved, axis=1))
    assert found.jitter == pytest.approx(size, rel=0.3)
    assert len(found.lost) + len(found.repeated) == 0


def test_model_errors_are_not_looked_for_where_rows_are_lost() -> None:
    """Their columns would have the same errors as the residuals; the times are said."""
    recording = measured(robot("ur5"), 3, noise=0.1)
    kept = np.random.default_rng(1).random(recording.samples) > 0.01
    count = int(kept.sum())
    torque, wrench = recording.measured("torque"), recording.measured("wrench")
    holed = tb.Recording(
        recording.names,
        recording.time[:count],
        recording.position[kept],
        torque=torque[kept],
        wrench=wrench[kept],
        tare=recording.tare,
    )
    found = tb.identify(robot("ur5"), holed, "torque")
    assert found.model_errors == ()
    assert "clock.lost-rows" in {each.code for each in found.diagnostics}
