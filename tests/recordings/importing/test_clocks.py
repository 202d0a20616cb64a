"""Sources with clocks of their own: onto one grid, and what is odd about them is said."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.recordings.importing.held_samples import held_share, slow_device
from testbed.recordings.importing.resampling import low_pass_reach, onto_grid

COLUMNS = "".join(f'"w{k}", ' for k in range(6))
TEXT = """
rate = {rate}
joints = ["j1"]
[sources.robot]
file = "robot.npz"
{robot}
[sources.plate]
file = "plate.npz"
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
"""


def put(path: Path, columns: Mapping[str, Any]) -> None:
    np.savez(path, **dict(columns))


def signal(t: Array) -> Array:
    return np.sin(2 * np.pi * 1.3 * t) + 0.3 * np.cos(2 * np.pi * 3.1 * t)


def made(folder: Path, robot: Array, plate: Array, *, rate: float = 500.0, **keys: str) -> None:
    """Both sources sample one signal, by their own clocks."""
    np.savez(folder / "robot.npz", t=robot, q=signal(robot))
    force = {f"w{k}": signal(plate) for k in range(6)}
    put(folder / "plate.npz", {"t": plate} | force)
    clock = 'time = "t"\ntime_unit = "s"\n'
    said = {name: clock + keys.get(name, "") for name in ("robot", "plate")}
    (folder / "map.toml").write_text(TEXT.format(rate=rate, columns=COLUMNS, **said))


def off(folder: Path) -> float:
    """Largest difference of the two sources on the grid."""
    found = tb.Recording.from_mapping(folder / "map.toml")
    return float(np.abs(found.position - found.measured("wrench")[:, :1]).max())


def test_sources_of_different_rates_meet_on_the_grid(tmp_path: Path) -> None:
    made(tmp_path, np.arange(0, 4, 1 / 500), np.arange(0.01, 4, 1 / 5000))
    assert off(tmp_path) < 2e-5
    made(tmp_path, np.arange(0, 4, 1 / 500), np.arange(0, 4, 1 / 333), rate=1000)
    assert off(tmp_path) < 1e-6


def test_an_offset_and_a_skew_are_taken_back(tmp_path: Path) -> None:
    """A plate whose clock is 2 ms ahead and 100 ppm slow."""
    true = np.arange(0, 20, 1e-3)
    made(tmp_path, np.arange(0, 20, 2e-3), true)
    shown = 0.002 + true / (1 + 1e-4)
    data = dict(np.load(tmp_path / "plate.npz")) | {"t": shown}
    put(tmp_path / "plate.npz", data)
    assert off(tmp_path) > 1e-2
    text = (tmp_path / "map.toml").read_text()
    cured = text.replace('"plate.npz"', '"plate.npz"\noffset = -0.002\nskew = 1e-4')
    (tmp_path / "map.toml").write_text(cured)
    assert off(tmp_path) < 1e-5


def test_a_delay_of_a_signal_is_taken_back(tmp_path: Path) -> None:
    true = np.arange(0, 4, 1e-3)
    made(tmp_path, true, true, rate=1000)
    data = dict(np.load(tmp_path / "plate.npz"))
    late = {f"w{k}": signal(true - 0.0153) for k in range(6)}
    put(tmp_path / "plate.npz", data | late)
    text = (tmp_path / "map.toml").read_text()
    (tmp_path / "map.toml").write_text(text + "delay = 0.0153\n")
    assert off(tmp_path) < 1e-6


def test_what_the_grid_cannot_hold_does_not_fold_into_it() -> None:
    time = np.arange(0, 4, 1 / 2000)
    reach = low_pass_reach(2000, 200)
    grid = np.arange(reach, 4 - reach - 1e-3, 1 / 200)
    for frequency in (110.0, 180.0, 390.0):
        fast = np.sin(2 * np.pi * frequency * time)[:, None]
        assert np.abs(onto_grid(time, fast, 2000, grid)).max() < 3e-4
    slow = np.sin(2 * np.pi * 60 * time)[:, None]
    wanted = np.sin(2 * np.pi * 60 * grid)[:, None]
    np.testing.assert_allclose(onto_grid(time, slow, 2000, grid), wanted, atol=3e-4)


def test_stamps_that_jitter_are_reported_and_steadied(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    true = np.arange(0, 8, 4e-3)
    stamps = true + 1e-3 * rng.uniform(-1, 1, len(true))
    made(tmp_path, true, true, rate=250)
    data = dict(np.load(tmp_path / "plate.npz")) | {"t": stamps}
    put(tmp_path / "plate.npz", data)
    found = tb.Recording.from_mapping(tmp_path / "map.toml")
    (warning,) = found.facts["warnings"]
    assert "stamps of source 'plate' jitter by 2" in warning
    assert "`steady = true` in [sources.plate]" in warning
    rough = off(tmp_path)
    text = (tmp_path / "map.toml").read_text()
    (tmp_path / "map.toml").write_text(text.replace('"plate.npz"', '"plate.npz"\nsteady = true'))
    assert off(tmp_path) < rough / 10
    gap = np.delete(stamps, slice(900, 1000))
    put(tmp_path / "plate.npz", {k: np.delete(v, slice(900, 1000)) for k, v in data.items()})
    assert len(gap) == len(stamps) - 100
    with pytest.raises(RecordingError, match="samples are missing"):
        tb.Recording.from_mapping(tmp_path / "map.toml")


def test_gaps_are_reported_and_long_ones_refused(tmp_path: Path) -> None:
    time = np.arange(0, 4, 2e-3)
    made(tmp_path, time, np.delete(time, slice(800, 820)))
    found = tb.Recording.from_mapping(tmp_path / "map.toml")
    assert found.facts["import"]["clocks"]["plate"]["gaps"] == 1
    assert "1 gap, the longest 0.042 s" in found.facts["warnings"][0]
    made(tmp_path, time, np.delete(time, slice(800, 1000)))
    with pytest.raises(RecordingError, match=r"nothing was recorded for 0.402 s after 1.598 s"):
        tb.Recording.from_mapping(tmp_path / "map.toml")
    text = (tmp_path / "map.toml").read_text()
    (tmp_path / "map.toml").write_text(text.replace("rate = 500.0", "rate = 500.0\nstart = 2.1"))
    assert tb.Recording.from_mapping(tmp_path / "map.toml").samples == pytest.approx(949, abs=2)


def test_repeated_samples_are_left_out_and_time_that_runs_back_is_refused(tmp_path: Path) -> None:
    time = np.arange(0, 4, 2e-3)
    made(tmp_path, time, np.sort(np.append(time, time[100:110])))
    found = tb.Recording.from_mapping(tmp_path / "map.toml")
    assert found.facts["import"]["clocks"]["plate"]["repeated"] == 10
    back = time.copy()
    back[[500, 501]] = back[[501, 500]]
    made(tmp_path, time, back)
    with pytest.raises(RecordingError, match="time does not increase after sample 500"):
        tb.Recording.from_mapping(tmp_path / "map.toml")


@pytest.mark.parametrize("times", [2, 3])
def test_a_slow_device_read_too_often_is_found_out(times: int, tmp_path: Path) -> None:
    time = np.arange(0, 6, 2e-3)
    made(tmp_path, time, time)
    data = dict(np.load(tmp_path / "plate.npz"))
    held = {k: np.repeat(v[::times], times)[: len(v)] for k, v in data.items() if k != "t"}
    put(tmp_path / "plate.npz", {"t": time} | held)
    found = tb.Recording.from_mapping(tmp_path / "map.toml")
    share = found.facts["import"]["signals"]["wrench"]["held"]
    assert share == pytest.approx(1 - 1 / times, abs=0.01)
    assert "`drop_held = true` in [sources.plate]" in found.facts["warnings"][0]
    rough = off(tmp_path)
    text = (tmp_path / "map.toml").read_text()
    (tmp_path / "map.toml").write_text(text.replace('"plate.npz"', '"plate.npz"\ndrop_held = true'))
    assert off(tmp_path) < rough / 100


def test_a_rest_is_no_slow_device() -> None:
    moving = np.random.default_rng(0).normal(size=(500, 2))
    values = np.concatenate([moving, np.repeat(moving[-1:], 200, axis=0), moving])
    assert held_share(values) == 0.0
    assert slow_device(values).all()


def test_of_a_run_of_equal_samples_the_first_is_news_and_then_every_so_many() -> None:
    """Whatever lengths the runs before had: a device that now and then misses a turn."""
    lengths = [3, 3, 2, 3, 7, 3, 1, 3, 3, 3]
    values = np.repeat(np.arange(len(lengths), dtype=float), lengths)[:, None]
    wanted = np.concatenate([np.arange(length) % 3 == 0 for length in lengths])
    np.testing.assert_array_equal(slow_device(values), wanted)


def test_sources_without_common_time_are_told_apart(tmp_path: Path) -> None:
    time = np.arange(0, 4, 2e-3)
    made(tmp_path, time, time + 100)
    with pytest.raises(RecordingError, match="no time in common: robot 0 to ") as error:
        tb.Recording.from_mapping(tmp_path / "map.toml")
    (cure,) = re.findall(r"\[sources.plate\] (offset = \S+)", str(error.value))
    text = (tmp_path / "map.toml").read_text()
    (tmp_path / "map.toml").write_text(text.replace('"plate.npz"', f'"plate.npz"\n{cure}'))
    assert off(tmp_path) < 1e-9


def test_a_clock_that_stands_is_not_another_clock(tmp_path: Path) -> None:
    made(tmp_path, np.arange(0, 4, 2e-3), np.full(2000, 7.0))
    with pytest.raises(RecordingError, match="sources.plate: 't' is the same at all samples"):
        tb.Recording.from_mapping(tmp_path / "map.toml")


def test_no_numbers_are_named_with_their_place(tmp_path: Path) -> None:
    time = np.arange(0, 4, 2e-3)
    made(tmp_path, time, time)
    data = dict(np.load(tmp_path / "robot.npz"))
    data["q"][700] = np.nan
    put(tmp_path / "robot.npz", data)
    with pytest.raises(
        RecordingError, match="sources.robot: 'q' of 'robot.npz' is nan at sample 700"
    ):
        tb.Recording.from_mapping(tmp_path / "map.toml")
