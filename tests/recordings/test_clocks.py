"""Sources with clocks of their own: onto one grid, and what is odd about them is said and cured."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.recordings.repeats import interpolate_repeated_poses, repeated_sample_share
from testbed.core.recordings.source import open_source
from testbed.importing.convert import import_recordings
from testbed.importing.foreign_table import TIME_UNITS
from testbed.importing.mapping import SourceTable
from testbed.importing.resampling import filter_half_length, resample_to_grid
from testbed.importing.source_clock import sample_times
from tests.helpers.foreign_files import imported, mapping
from tests.helpers.refusals import refuses
from tests.helpers.strategies import rngs

CLOCK = np.arange(0, 4, 2e-3)


def signal(t: Array) -> Array:
    return np.sin(2 * np.pi * 1.3 * t) + 0.3 * np.cos(2 * np.pi * 3.1 * t)


class Logs:
    """Two sources that sample one signal by their own clocks, and what a mapping makes of them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def write(self, robot: Array, plate: Array, shown: Array | None = None, times: int = 1) -> None:
        """The robot's clock and the plate's, which may show other instants, and hold samples."""
        values = np.repeat(signal(plate)[::times], times)[: len(plate)]
        np.savez(self.folder / "log.npz", t=robot, q=signal(robot))
        np.savez(self.folder / "plate.npz", t=plate if shown is None else shown, w=values)

    def recording(self, plate: str = "", wrench: str = "", rate: str = "500") -> tb.Recording:
        """What the mapping makes of them, with something more in it."""
        sources = "\n".join(
            f'[sources.{name}]\nfile = "{name}.npz"\ntime = "t"\ntime_unit = "s"'
            for name in ("log", "plate")
        )
        text = mapping(f"{sources}\n{plate}", ["q", "q"], ["q", "q"], ["w"] * 6, plate="plate")
        return imported(self.folder, text.replace("rate = 100", f"rate = {rate}") + wrench)

    def off(self, plate: str = "", wrench: str = "", rate: str = "500") -> float:
        """Largest difference of the two sources on the grid."""
        found = self.recording(plate, wrench, rate)
        return float(np.abs(found.position[:, :1] - found.measured("wrench")[:, :1]).max())


@pytest.fixture
def logs(tmp_path: Path) -> Logs:
    return Logs(tmp_path)


def test_offsets_skews_and_delays_are_taken_back_on_a_common_grid(logs: Logs) -> None:
    """Of 500, 5000, 333 and 1000 Hz; a plate that is 2 ms ahead and 100 ppm slow, or 15 ms late."""
    logs.write(CLOCK, np.arange(0.01, 4, 1 / 5000))
    assert logs.off() < 2e-5
    signals = logs.recording().metadata.report["signals"]
    assert (signals["position"]["low_pass"], signals["wrench"]["low_pass"]) == (False, True)
    logs.write(CLOCK, np.arange(0, 4, 1 / 333))
    assert logs.off(rate="1000") < 1e-6
    true = np.arange(0, 20, 1e-3)
    logs.write(np.arange(0, 20, 2e-3), true, 0.002 + true / (1 + 1e-4))
    assert logs.off() > 1e-2
    assert logs.off(plate="offset = -0.002\nskew = 1e-4") < 1e-5
    logs.write(CLOCK, CLOCK, CLOCK + 0.0153)
    assert logs.off(wrench="delay = 0.0153") < 1e-6
    logs.write(CLOCK, CLOCK, CLOCK + 100)
    with pytest.raises(RecordingError) as refused:
        logs.recording()
    (cure,) = re.findall(r"\[sources.plate\] (offset = \S+)", str(refused.value))
    assert logs.off(plate=cure) < 1e-9


@given(frequency=st.floats(20.0, 900.0))
def test_what_the_grid_cannot_hold_does_not_fold_into_it(frequency: float) -> None:
    """Witness: the sine itself, below two thirds of Nyquist's frequency; nothing above it."""
    time = np.arange(0, 2, 1 / 2000)
    reach = filter_half_length(2000, 200)
    grid = np.arange(reach, 2 - reach - 1e-3, 1 / 200)
    found = resample_to_grid(time, np.sin(2 * np.pi * frequency * time)[:, None], 2000, grid)[:, 0]
    if frequency < 66:
        np.testing.assert_allclose(found, np.sin(2 * np.pi * frequency * grid), atol=5e-4)
    if frequency > 110:
        assert np.abs(found).max() < 5e-4


def test_stamps_that_jitter_and_samples_that_are_held_are_said_and_cured(logs: Logs) -> None:
    """A robot at rest holds nothing; a device may now and then miss a turn."""
    rng = np.random.default_rng(0)
    true = np.arange(0, 8, 4e-3)
    stamps = true + 1e-3 * rng.uniform(-1, 1, len(true))
    logs.write(true, true, stamps)
    (said,) = logs.recording(rate="250").metadata.diagnostics
    assert said.code == "import.jitter"
    assert logs.off(rate="250", plate="steady = true") < logs.off(rate="250") / 10
    gone = np.delete(np.arange(len(true)), slice(900, 1000))
    logs.write(true, true[gone], stamps[gone])
    with refuses(RecordingError, "plate"):  # no steady device has gaps
        logs.recording(rate="250", plate="steady = true")
    every = logs.recording(rate="250", plate="max_gap = 1").metadata.diagnostics
    (jitter,) = (each for each in every if each.code == "import.jitter")
    assert "steady" not in jitter.remedy  # nor is it advised
    for times in (2, 3):
        logs.write(CLOCK, CLOCK, times=times)
        metadata = logs.recording().metadata
        share = metadata.report["signals"]["wrench"]["held"]
        assert share == pytest.approx(1 - 1 / times, abs=0.01)
        assert metadata.diagnostics[0].code == "import.held"
        assert logs.off(plate="drop_held = true") < logs.off() / 100
    moving = rng.normal(size=(500, 2))
    rests = np.concatenate([moving, np.repeat(moving[-1:], 200, axis=0), moving])
    assert repeated_sample_share(rests) == 0.0


def test_gaps_are_bridged_or_cut_and_time_that_repeats_or_runs_back_is_named(logs: Logs) -> None:
    """What is left between two gaps is a piece, but for what is shorter than a second."""
    for shown, what in ((np.delete(CLOCK, slice(800, 820)), "gaps"),
                        (np.sort(np.append(CLOCK, CLOCK[100])), "repeated")):  # fmt: skip
        logs.write(CLOCK, shown)
        assert logs.recording().metadata.report["clocks"]["plate"][what] == 1
    back, twice = CLOCK.copy(), CLOCK.copy()
    back[[500, 501]], twice[501] = back[[501, 500]], twice[500]
    for shown in (back, twice):
        logs.write(CLOCK, CLOCK, shown)
        with refuses(RecordingError, "plate", "sample 500"):
            logs.recording()
    logs.write(CLOCK, CLOCK, np.full(2000, 7.0))
    with refuses(RecordingError, "sources.plate", "'t'"):
        logs.recording()
    long = np.arange(0, 10, 2e-3)
    silent = (long > 2) & (long < 3.5) | (long > 3.7) & (long < 5)
    logs.write(long[~silent], long[(long < 7.5) | (long > 8)])
    whole = logs.recording()
    parts, said = import_recordings(logs.folder / "map.toml")
    for part, segment in zip(parts, whole.segments, strict=True):
        np.testing.assert_array_equal(whole.part(*segment).position, part.position)
    assert [*whole.metadata.diagnostics] == said
    ends = [(round(part.samples / part.rate, 2), round(part.rate, 6)) for part in parts]
    assert ends == [(2.0, 500.0), (2.5, 500.0), (2.0, 500.0)]
    codes = [*["import.cut"] * 3, "import.short"]  # and that a piece was left out
    assert [each.code for each in said] == codes
    for part, begin in zip(parts, (0.0, 5.0, 8.0), strict=True):
        at = begin + part.time - part.time[0]
        assert part.time[0] == pytest.approx(begin, abs=3e-3)
        apart = [np.abs(part.position[:, 0] - signal(at + k * 2e-3)).max() for k in (0, 1)]
        assert min(apart) < 1e-6  # it begins with a sample, or with the next
    logs.write(CLOCK, np.delete(CLOCK, slice(800, 1000)))
    assert logs.recording(plate="max_gap = 1").samples == pytest.approx(2000, abs=2)
    assert logs.recording(rate="500\nstart = 2.1").samples == pytest.approx(949, abs=2)


@given(rng=rngs, unit=st.sampled_from(["s", "ms", "us", "ns", "min"]), by_file=st.booleans())
def test_times_are_in_the_units_of_file_or_mapping_and_whole_ones_keep_all_digits(
    rng: np.random.Generator, unit: str, by_file: bool
) -> None:
    """Since 1970, where floating-point seconds would be a quarter of a microsecond apart."""
    source = SourceTable(file="log.npz", time="t", time_unit=None if by_file else unit)
    scale = round(1 / TIME_UNITS[unit])  # 0 of minutes
    ticks = np.cumsum(rng.integers(1, 5000, 100)) + 1_761_234_567 * scale
    known = unit if by_file else "V"  # what is no unit of time says nothing
    stamps: Any = ticks if scale > 1 else 0.5 * ticks
    found = sample_times("log", source, stamps, known)
    if scale > 1:
        exact = [int(tick) - int(found.start) * scale for tick in ticks]
        np.testing.assert_allclose(
            found.time_after_start, np.array(exact) / scale, rtol=1e-15, atol=0
        )
    else:
        seconds = found.start + np.asarray(found.time_after_start)
        np.testing.assert_allclose(seconds, 0.5 * ticks * TIME_UNITS[unit], rtol=1e-15)


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
    found, share = interpolate_repeated_poses(open_source(recording(shown)))
    assert share == pytest.approx(1 - 1 / every, abs=1e-3)
    apart = found.part(0, found.samples).position - motion()[: found.samples]
    assert np.abs(apart).max() < 1e-3 * np.abs(shown - motion()).max()
    assert 3000 - found.samples < every


def test_steps_of_an_encoder_and_rests_are_no_slow_device() -> None:
    """Else coarse encoders would be taken for exact ones."""
    still = np.where(np.arange(3000)[:, None] % 500 < 250, motion(), motion()[:1])
    for other in (motion(), np.round(motion(), 2), np.round(0.1 * motion(), 3), still):
        source = open_source(recording(other))
        assert interpolate_repeated_poses(source) == (source, 0.0)
