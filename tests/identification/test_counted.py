"""Only the samples that are for an estimate count, wherever the recording lies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError, SettingsError
from testbed.identification.open_counted import open_counted
from testbed.recordings.recording import Recording
from tests.helpers.ideal import ideal
from tests.helpers.runs import noisy, robot

ROBOTS = ("puma", "gantry", "random")


def recorded(name: str, **facts: object) -> Recording:
    tree = robot(name)
    made = noisy(ideal(tree, duration=8.0))
    return replace(made, facts={**made.facts, **facts})


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_what_does_not_count_changes_nothing(name: str, tmp_path: Path) -> None:
    """A span in the settings, in the recording, or a recording that is that span: the same bits."""
    tree, whole = robot(name), recorded(name)
    rate, begin = whole.rate, float(whole.time[0])
    span = [begin + 1.5, begin + 6.5]
    cut = whole.part(round(1.5 * rate), round(6.5 * rate))
    wanted = tb.identify(tree, cut)
    wild = np.array(whole.measured("wrench"))
    wild[: round(1.5 * rate)] += 100.0
    wild[round(6.5 * rate) :] -= 100.0
    upset = replace(whole, wrench=wild)
    said = replace(upset, facts={**upset.facts, "counted": span})
    said.save(tmp_path / "said.parquet")
    for what, settings in (
        (upset, tb.Settings(span=span)),
        (said, None),
        (tmp_path / "said.parquet", None),
    ):
        found = tb.identify(tree, what, settings=settings)
        np.testing.assert_array_equal(found.values, wanted.values)
        np.testing.assert_array_equal(found.covariance, wanted.covariance)


def test_settings_go_before_what_the_recording_says() -> None:
    said = recorded("puma", counted=[0.0, 2.0])
    both = open_counted(said, tb.Settings(span=[1.0, 5.0]))
    assert both.samples == round(4.0 * said.rate)
    assert both.part(0, 1).time[0] == pytest.approx(1.0)


def test_a_time_without_samples_is_refused() -> None:
    whole = recorded("puma")
    with pytest.raises(RecordingError, match=r"has nothing from 50 to 60 s.*identification\.span"):
        open_counted(whole, tb.Settings(span=[50.0, 60.0]))
    for wrong in ([1.0], [2.0, 1.0], [1.0, 1.0], "ab", ["a", 2], [0, 1, 2], [0.0, np.inf]):
        with pytest.raises(SettingsError, match="span is two times"):
            tb.Settings(span=wrong)  # type: ignore[arg-type]


def test_a_file_that_says_nonsense_of_it_is_refused(tmp_path: Path) -> None:
    recorded("puma", counted=["a", 2]).save(tmp_path / "wrong.parquet")
    with pytest.raises(RecordingError, match="'counted'"):
        Recording.load(tmp_path / "wrong.parquet")
