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
from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.recordings.importing.foreign_units import TIMES
from testbed.recordings.importing.held_samples import held_share, slow_device
from testbed.recordings.importing.import_report import ImportReport
from testbed.recordings.importing.mapping import SourceTable
from testbed.recordings.importing.pieces import pieces
from testbed.recordings.importing.resampling import low_pass_reach, onto_grid
from testbed.recordings.importing.source_clock import sample_times, without_repeats
from tests.helpers.refusals import refuses
from tests.helpers.strategies import rngs

COLUMNS = "".join(f'"w{k}", ' for k in range(6))
TEXT = """
rate = {rate}
joints = ["j1"]
[sources.robot]
file = "robot.npz"
time = "t"
time_unit = "s"
[sources.plate]
file = "plate.npz"
time = "t"
time_unit = "s"
{plate}
[position]
source = "robot"
columns = ["q"]
unit = "rad"
[wrench]
source = "plate"
columns = [{columns}]
units = ["N", "N m"]
sense = "on_robot"
{wrench}
"""
CLOCK = np.arange(0, 4, 2e-3)


def signal(t: Array) -> Array:
    return np.sin(2 * np.pi * 1.3 * t) + 0.3 * np.cos(2 * np.pi * 3.1 * t)


class Logs:
    """Two sources that sample one signal by their own clocks, and what a mapping makes of them."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.said = folder, {"plate": "", "wrench": "", "rate": "500"}

    def write(self, robot: Array, plate: Array, shown: Array | None = None, times: int = 1) -> None:
        """The robot's clock and the plate's, which may show other instants, and hold samples."""
        values = np.repeat(signal(plate)[::times], times)[: len(plate)]
        np.savez(self.folder / "robot.npz", t=robot, q=signal(robot))
        force: dict[str, Any] = {f"w{k}": values for k in range(6)}
        np.savez(self.folder / "plate.npz", t=plate if shown is None else shown, **force)

    def recording(self, **said: str) -> tb.Recording:
        """What the mapping makes of them, with something more in it."""
        text = TEXT.format(columns=COLUMNS, **{**self.said, **said})
        (self.folder / "map.toml").write_text(text)
        return tb.Recording.from_mapping(self.folder / "map.toml")

    def off(self, **said: str) -> float:
        """Largest difference of the two sources on the grid."""
        found = self.recording(**said)
        return float(np.abs(found.position - found.measured("wrench")[:, :1]).max())


@pytest.fixture
def logs(tmp_path: Path) -> Logs:
    return Logs(tmp_path)


def test_offsets_skews_and_delays_are_taken_back_on_a_common_grid(logs: Logs) -> None:
    """Of 500, 5000, 333 and 1000 Hz; a plate that is 2 ms ahead and 100 ppm slow, or 15 ms late."""
    logs.write(CLOCK, np.arange(0.01, 4, 1 / 5000))
    assert logs.off() < 2e-5
    logs.write(CLOCK, np.arange(0, 4, 1 / 333))
    assert logs.off(rate="1000") < 1e-6
    true = np.arange(0, 20, 1e-3)
    logs.write(np.arange(0, 20, 2e-3), true, 0.002 + true / (1 + 1e-4))
    assert logs.off() > 1e-2
    assert logs.off(plate="offset = -0.002\nskew = 1e-4") < 1e-5
    logs.write(CLOCK, CLOCK, CLOCK + 0.0153)
    assert logs.off(wrench="delay = 0.0153") < 1e-6
    logs.write(CLOCK, CLOCK + 100)
    with pytest.raises(RecordingError) as refused:
        logs.recording()
    (cure,) = re.findall(r"\[sources.plate\] (offset = \S+)", str(refused.value))
    moved = dict(np.load(logs.folder / "plate.npz"))
    np.savez(logs.folder / "plate.npz", **(moved | {f"w{k}": signal(CLOCK) for k in range(6)}))
    assert logs.off(plate=cure) < 1e-9


@given(frequency=st.floats(20.0, 900.0))
def test_what_the_grid_cannot_hold_does_not_fold_into_it(frequency: float) -> None:
    """Witness: the sine itself, below two thirds of Nyquist's frequency; nothing above it."""
    time = np.arange(0, 2, 1 / 2000)
    reach = low_pass_reach(2000, 200)
    grid = np.arange(reach, 2 - reach - 1e-3, 1 / 200)
    found = onto_grid(time, np.sin(2 * np.pi * frequency * time)[:, None], 2000, grid)[:, 0]
    if frequency < 66:
        np.testing.assert_allclose(found, np.sin(2 * np.pi * frequency * grid), atol=5e-4)
    if frequency > 110:
        assert np.abs(found).max() < 5e-4


def test_stamps_that_jitter_and_samples_that_are_held_are_said_and_cured(logs: Logs) -> None:
    rng = np.random.default_rng(0)
    true = np.arange(0, 8, 4e-3)
    stamps = true + 1e-3 * rng.uniform(-1, 1, len(true))
    logs.write(true, true, stamps)
    made = logs.recording(rate="250")
    (warning,) = made.facts["warnings"]
    report = ImportReport.from_dict(made.facts["import"])
    assert report.as_dict() == made.facts["import"]
    for line, said in zip(report.lines(), (f"{made.samples}", "'robot'", "'plate'"), strict=False):
        assert said in line
    assert [said in warning for said in ("[sources.plate]", "steady = true")] == [True, True]
    assert logs.off(rate="250", plate="steady = true") < logs.off(rate="250") / 10
    gone = np.delete(np.arange(len(true)), slice(900, 1000))
    logs.write(true, true[gone], stamps[gone])
    with refuses(RecordingError, "plate"):  # no steady device has gaps
        logs.recording(rate="250", plate="steady = true")
    for times in (2, 3):
        logs.write(CLOCK, CLOCK, times=times)
        found = logs.recording()
        share = found.facts["import"]["signals"]["wrench"]["held"]
        assert share == pytest.approx(1 - 1 / times, abs=0.01)
        assert "drop_held = true" in found.facts["warnings"][0]
        assert logs.off(plate="drop_held = true") < logs.off() / 100
    lengths = [3, 3, 2, 3, 7, 3, 1, 3, 3, 3]  # a device that now and then misses a turn
    values = np.repeat(np.arange(10.0), lengths)[:, None]
    news = np.concatenate([np.arange(length) % 3 == 0 for length in lengths])
    np.testing.assert_array_equal(slow_device(values), news)
    moving = rng.normal(size=(500, 2))
    rests = np.concatenate([moving, np.repeat(moving[-1:], 200, axis=0), moving])
    assert held_share(rests) == 0.0
    assert slow_device(rests).all()


def test_gaps_are_bridged_or_cut_and_time_that_repeats_or_runs_back_is_named(logs: Logs) -> None:
    """What is left between two gaps is a piece, but for what is shorter than a second."""
    logs.write(CLOCK, np.delete(CLOCK, slice(800, 820)))
    found = logs.recording()
    assert found.facts["import"]["clocks"]["plate"]["gaps"] == 1
    assert "plate" in found.facts["warnings"][0]
    logs.write(CLOCK, np.sort(np.append(CLOCK, CLOCK[100:110])))
    assert logs.recording().facts["import"]["clocks"]["plate"]["repeated"] == 10
    back = CLOCK.copy()
    back[[500, 501]] = back[[501, 500]]
    logs.write(CLOCK, CLOCK, back)
    with refuses(RecordingError, "plate", "sample 500"):
        logs.recording()
    logs.write(CLOCK, CLOCK, np.full(2000, 7.0))
    with refuses(RecordingError, "sources.plate", "'t'"):
        logs.recording()
    long = np.arange(0, 10, 2e-3)
    silent = (long > 2) & (long < 3.5) | (long > 3.7) & (long < 5)
    logs.write(long[~silent], long[(long < 7.5) | (long > 8)])
    with refuses(RecordingError, "testbed import"):
        logs.recording()
    parts, lines = pieces(logs.folder / "map.toml")
    ends = [(round(part.samples / part.rate, 2), round(part.rate, 6)) for part in parts]
    assert ends == [(2.0, 500.0), (2.5, 500.0), (2.0, 500.0)]
    names = ("robot", "robot", "plate", "")  # and that a piece was left out
    assert [name in line for line, name in zip(lines, names, strict=True)] == [True] * 4
    for part, begin in zip(parts, (0.0, 5.0, 8.0), strict=True):
        at = begin + part.time - part.time[0]
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
    ticks, scale = np.cumsum(rng.integers(1, 5000, 100)), round(1 / TIMES[unit])
    if scale > 1:
        epoch = 1_761_234_567
        known = unit if by_file else "V"  # what is no unit of time says nothing
        found = sample_times("log", source, ticks + epoch * scale, 100, known)
        exact = [int(tick) + (epoch - int(found.start)) * scale for tick in ticks]
        np.testing.assert_allclose(found.since, np.array(exact) / scale, rtol=1e-15, atol=0)
    else:
        halves = np.asarray(0.5 * ticks, dtype=np.float64)
        found = sample_times("log", source, halves, 100, unit if by_file else None)
        seconds = found.start + np.asarray(found.since)
        np.testing.assert_allclose(seconds, 0.5 * ticks * TIMES[unit], rtol=1e-15)


def test_times_that_contradict_or_tell_nothing_are_refused() -> None:
    stamps, milli = np.arange(10.0), SourceTable(file="log.npz", time="t", time_unit="ms")
    with refuses(RecordingError, "us", "ms"):
        sample_times("log", milli, stamps, 10, "us")
    with refuses(RecordingError, "time_unit"):
        sample_times("log", SourceTable(file="log.npz", time="t"), stamps, 10, "V")
    steady = sample_times("log", SourceTable(file="log.npz", rate=50.0), None, 4, None)
    np.testing.assert_allclose(steady.since, [0, 0.02, 0.04, 0.06])
    time, values = np.array([0.0, 1.0, 1.0, 2.0]), np.array([[1.0], [3.0], [3.0], [3.0]])
    np.testing.assert_array_equal(without_repeats("log", time, values), [True, True, False, True])
    values[2] = 5.0
    with refuses(RecordingError, "sample 1"):
        without_repeats("log", time, values)
