"""Times of a source: its unit is the file's or the mapping's, never a third."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from testbed.errors import RecordingError
from testbed.recordings.importing.foreign_units import TIMES
from testbed.recordings.importing.mapping import SourceTable
from testbed.recordings.importing.source_clock import clock_report, sample_times, without_repeats

STAMPS = np.arange(10.0)


def source(**keys: Any) -> SourceTable:
    return SourceTable(file="log.npz", time="t", **keys)


@pytest.mark.parametrize(
    ("said", "known", "step"),
    [
        ("ms", None, 1e-3),
        (None, "us", 1e-6),
        ("ms", "ms", 1e-3),
        ("min", "V", 60.0),
        ("s", "", 1.0),
    ],
)
def test_a_unit_is_the_files_or_the_mappings(
    said: str | None, known: str | None, step: float
) -> None:
    """What is no unit of time says nothing."""
    found = sample_times("log", source(time_unit=said), STAMPS, 10, known)
    assert found.start == 0
    np.testing.assert_allclose(found.since, step * STAMPS, rtol=1e-15)


def test_units_that_contradict_each_other_or_are_nowhere_are_refused() -> None:
    with pytest.raises(RecordingError, match="the file says its times are in us, time_unit is ms"):
        sample_times("log", source(time_unit="ms"), STAMPS, 10, "us")
    with pytest.raises(RecordingError, match="say `time_unit`"):
        sample_times("log", source(), STAMPS, 10, "V")


def test_a_rate_needs_no_stamps() -> None:
    steady = SourceTable(file="log.npz", rate=50.0)
    found = sample_times("log", steady, None, 4, None)
    np.testing.assert_allclose(found.since, [0, 0.02, 0.04, 0.06])


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_whole_numbers_since_1970_keep_all_digits(unit: str) -> None:
    """As floating-point numbers of seconds they would be a quarter of a microsecond apart."""
    rng = np.random.default_rng(4)
    scale = round(1 / TIMES[unit])
    ticks = np.cumsum(rng.integers(1, 5000, 1000))
    found = sample_times("log", source(time_unit=unit), ticks + 1_761_234_567 * scale, 1000, None)
    assert found.start % 60 == 0
    exact = [int(tick) + (1_761_234_567 - int(found.start)) * scale for tick in ticks]
    np.testing.assert_allclose(found.since, np.array(exact) / scale, rtol=1e-15, atol=0)


def test_a_time_that_is_no_number_is_named() -> None:
    stamps = np.where(STAMPS == 7, np.nan, STAMPS)
    with pytest.raises(RecordingError, match="'t' is no number at sample 7"):
        sample_times("log", source(time_unit="s"), stamps, 10, None)


@pytest.mark.parametrize(("count", "enough"), [(3, False), (4, True)])
def test_a_handful_of_samples_is_no_recording(count: int, enough: bool) -> None:
    time = 0.01 * STAMPS[:count]
    if enough:
        clock_report("log", source(), time, time, 0)
    else:
        with pytest.raises(RecordingError, match="3 samples, which is no recording"):
            clock_report("log", source(), time, time, 0)


def test_only_what_repeats_in_every_column_is_left_out() -> None:
    time = np.array([0.0, 1.0, 1.0, 2.0])
    values = np.array([[1.0, 2.0], [3.0, 4.0], [3.0, 4.0], [3.0, 4.0]])
    np.testing.assert_array_equal(without_repeats("log", time, values), [True, True, False, True])
    values[2, 1] = 5.0
    with pytest.raises(RecordingError, match="does not increase after sample 1 .* 1 such"):
        without_repeats("log", time, values)
