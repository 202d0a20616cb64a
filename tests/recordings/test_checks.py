"""What is no measurement, or not sampled evenly, is named where it is."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.errors import RecordingError, plural
from testbed.recordings.checks import check_columns, check_times, check_values, checked_metadata

TIME = np.arange(20) / 10


def columns(**changed: Array) -> dict[str, Array]:
    return {"time": TIME, "position/a": np.ones(20), **changed}


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e12, -1e12])
def test_values_that_nothing_measures_are_named_with_their_place(bad: float) -> None:
    values = np.ones(20)
    values[[7, 9, 12]] = bad
    with pytest.raises(RecordingError) as caught:
        check_values(columns(**{"wrench/Fx": values}), "the recording", first=100)
    assert str(caught.value).startswith(
        f"the recording: channel 'wrench/Fx' is {bad:g} at sample 107 (t = 0.7 s), "
        "one of 3 such among samples 100 to 119;"
    )


def test_the_largest_measurement_is_one() -> None:
    check_values(columns(**{"wrench/Fx": np.full(20, 0.999e12)}), "r")
    check_columns(columns(), "r")


@pytest.mark.parametrize("count", [0, 1])
def test_one_sample_is_no_recording(count: int) -> None:
    with pytest.raises(
        RecordingError, match=f"^r: {plural(count, 'sample')}, which is no recording$"
    ):
        check_columns({"time": TIME[:count], "position/a": np.ones(count)}, "r")


@pytest.mark.parametrize("late", [0.0, -0.05])
def test_time_that_does_not_increase_is_named_by_its_sample(late: float) -> None:
    time = TIME.copy()
    time[5] = time[4] + late
    with pytest.raises(RecordingError, match="does not increase after sample 1004$"):
        check_times(time, "r", 0.1, first=1000)


@pytest.mark.parametrize("share", [0.012, -0.012])
def test_steps_may_differ_by_a_hundredth(share: float) -> None:
    time = TIME.copy()
    time[5:] += share / 1.5 * 0.1
    check_times(time, "r", 0.1)
    time[5:] += share / 3 * 0.1
    found = 0.1 * (1 + share)
    with pytest.raises(
        RecordingError, match=rf"not uniform: {found:.6g} s after sample 1004, 0\.1 s elsewhere"
    ):
        check_times(time, "r", 0.1, first=1000)


@pytest.mark.parametrize("typical", [0.9e-9, 1.1e6])
def test_sampling_times_that_are_a_mistake_are_refused(typical: float) -> None:
    with pytest.raises(RecordingError, match="is no sampling time"):
        check_times(typical * np.arange(5.0), "r", typical)


@pytest.mark.parametrize("typical", [1.1e-9, 0.9e6])
def test_very_fast_and_very_slow_sampling_is_sampling(typical: float) -> None:
    check_times(typical * np.arange(5.0), "r", typical)


@pytest.mark.parametrize("count", [0, 1])
def test_a_part_without_steps_is_even(count: int) -> None:
    check_times(TIME[:count], "r", 0.1)


def test_metadata_are_kept_as_they_are() -> None:
    facts = {
        "gravity": [0, 0, -1.6],
        "warnings": ["a"],
        "own": {"deep": [1]},
        "geometry": {"a": {}},
    }
    assert checked_metadata({"tare": [1, 2, 3, 4, 5, 6.5], "facts": facts}) == (
        (1.0, 2.0, 3.0, 4.0, 5.0, 6.5),
        facts,
    )
    assert checked_metadata({}) == (None, {})
    assert checked_metadata({"tare": None, "facts": None}) == (None, {})


@pytest.mark.parametrize(
    ("joint", "said"),
    [
        ({"kind": "ball"}, "kind is revolute or prismatic"),
        ({"parent": 3}, "parent is no name"),
        ({"axis": [1, 0]}, "axis is not 3 numbers"),
        ({"offset": [1, 0, 0, 0]}, "offset is not 3 numbers"),
        ({"rotation": [1, 0, 0]}, "rotation is not"),
        ({"rotation": [[1, 0, 0], [0, 1, 0]]}, "rotation is not 3 x 3 numbers"),
        ({"axis": [1, 0, True]}, "axis is not 3 numbers"),
        ({"axis": [1, 0, 1e12]}, "axis is not 3 numbers"),
        ({"axis": [1, 0, -1e12]}, "axis is not 3 numbers"),
    ],
)
def test_a_joints_geometry_that_is_none_is_named(joint: object, said: str) -> None:
    with pytest.raises(ValueError, match=said) as caught:
        checked_metadata({"facts": {"geometry": {"fine": {"axis": [1, 0, 0]}, "elbow": joint}}})
    assert "joint 'elbow'" in str(caught.value)


@pytest.mark.parametrize("found", [None, [], "facts", 3])
def test_metadata_are_a_table(found: object) -> None:
    with pytest.raises(ValueError, match="^its metadata are not a table$"):
        checked_metadata(found)
