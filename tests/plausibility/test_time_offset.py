"""How late a signal is: found to microseconds, taken back, and always said."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import testbed as tb
from benchmarks.inverse_recordings import truth
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.importing.check.assessment import assess_recording
from testbed.importing.check.check import check_recording, import_and_check
from testbed.importing.check.draft_mapping import ASSUMED_NOTE, missing_keys
from testbed.importing.check.mapping_solution import solve_mapping
from testbed.importing.check.time_offset import time_offsets
from testbed.importing.guess import guess_mapping
from tests.helpers.measured import measured, random_fourier
from tests.helpers.riding import riding
from tests.helpers.robots import random_robot
from tests.helpers.runs import robot, without

pytestmark = pytest.mark.slow
LATE, SKEW = 2e-3, 1e-4


def shifted(signal: Array, time: Array, late: Array | float) -> Array:
    """A signal that is late, by a spline."""
    inside = np.clip(time - late, time[0], time[-1])
    return np.asarray(make_interp_spline(time, signal, k=5)(inside))


@pytest.mark.parametrize(("name", "late"), [("puma", 2e-3), ("gantry", -0.03)])
def test_a_late_plate_and_late_torques_are_found(name: str, late: float) -> None:
    """To 20 us, whatever rounding does; a drift that no clock has is not taken for one."""
    tree, recording = robot(name), measured(robot(name), rate=500.0, noise=0.1)
    time, wrench = recording.time, recording.measured("wrench")
    torque = shifted(recording.measured("torque"), time, late)
    spoiled = replace(recording, torque=torque, wrench=shifted(wrench, time, late / 2))
    rounded = replace(spoiled, position=np.nextafter(spoiled.position, np.inf))
    found, again = time_offsets(tree, spoiled), time_offsets(tree, rounded)
    for each, other, wanted in zip(found, again, (late, late / 2), strict=True):
        assert (each.is_late, each.is_drifting) == (True, False)
        assert abs(each.delay - wanted) < max(2e-5, 5 * each.sigma)
        assert abs(each.delay - other.delay) < 1e-5 * each.sigma
    fast = replace(recording, torque=None, wrench=shifted(wrench, time, 5e-3 * (time - 10)))
    (plate,) = time_offsets(tree, fast)
    assert not plate.is_drifting


def test_sigma_of_a_delay_is_honest() -> None:
    """Z of delays of random trees that are on time: about one."""
    found = []
    for seed in range(6):
        tree = random_robot(np.random.default_rng(seed), 3).tree()
        recording = measured(tree, seed, duration=10.0, rate=200.0)
        found += [(each.delay / each.sigma, each.is_late) for each in time_offsets(tree, recording)]
    z = np.array([value for value, _ in found])
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.8
    assert not any(late for _, late in found)


@pytest.mark.parametrize(("late", "degrees"), [(-2.4, False), (0.13, True)])
def test_a_plate_whose_clock_is_off_by_far_is_no_other_robot(late: float, degrees: bool) -> None:
    """Its delay is the mapping's line, beside other cures; `align` takes it back."""
    tree = robot("ur5")
    recording = without(measured(tree, 4), "torque")
    inside = (recording.time > abs(late)) & (recording.time < recording.time[-1] - abs(late))
    wrench = shifted(recording.measured("wrench"), recording.time, late)[inside]
    read = replace(
        recording, time=recording.time[: len(wrench)], wrench=wrench,
        position=recording.position[inside] * (180 / np.pi if degrees else 1),
    )  # fmt: skip
    found = assess_recording(tree, read)
    assert [each.kind for each in found.remedies] == ["late", *["degrees"] * degrees]
    ((table, key, value),) = found.remedies[0].lines
    assert (table, key) == ("wrench", "delay")
    assert value == pytest.approx(late, abs=5e-3)
    with pytest.raises(RecordingError):
        found.raise_errors()
    if not degrees:
        (clock,) = check_recording(tree, read, align=True).offsets
        assert clock.delay == pytest.approx(late, abs=max(1e-3, 5 * clock.sigma))


MAPPING = """
rate = 1000
joints = JOINTS
[sources.robot]
file = "robot.npz"
rate = 500
[sources.plate]
file = "plate.npz"
time = "t"
time_unit = "s"
[position]
source = "robot"
columns = COLUMNS
unit = "rad"
[wrench]
source = "plate"
columns = ["w[0]", "w[1]", "w[2]", "w[3]", "w[4]", "w[5]"]
units = ["N", "N m"]
sense = "on_robot"
"""


def two_sources(folder: Path, tree: tb.Tree, late: float, skew: float) -> Path:
    """Encoders at 500 Hz; a plate at 1 kHz by a clock of its own, sampled as it shows."""
    rng = np.random.default_rng(3)
    motion = random_fourier(tree, rng, 1.0)
    slow, fast = np.arange(0, 20, 2e-3), np.arange(0, 20, 1e-3)
    position = motion.at(slow).q + 1e-4 * rng.normal(size=(len(slow), tree.n))
    wrench = tb.base_wrench(tree, motion.at(fast)) + tb.pedestal_wrench(tree)
    wrench = wrench + rng.normal(size=wrench.shape) * [0.5, 0.5, 0.5, 0.1, 0.1, 0.1]
    np.savez(folder / "robot.npz", q=position)
    np.savez(folder / "plate.npz", t=late + fast / (1 + skew), w=wrench)
    columns = json.dumps([f"q[{k}]" for k in range(tree.n)])
    said = MAPPING.replace("JOINTS", json.dumps(tree.names)).replace("COLUMNS", columns)
    (folder / "map.toml").write_text(said)
    return folder / "map.toml"


def error(tree: tb.Tree, recording: tb.Recording) -> float:
    """Rms of the external estimate's errors, each in parts of its unit's largest parameters."""
    settings = tb.Settings(model_errors=False)  # which would take a wrong clock out
    estimate = tb.identify(tree, recording, "wrench", settings=settings)
    values = tb.fit(estimate.normal_equations).values  # plain weighted least squares
    true = estimate.minimal.values(tb.barycentric(tree))
    units = np.array(estimate.units)
    largest = np.array([np.abs(true[units == unit]).max() for unit in units])
    size = np.maximum(np.abs(true), 0.05 * largest)
    return float(np.sqrt(np.mean(((values - true) / size) ** 2)))


def test_two_clocks_are_as_good_as_one(tmp_path: Path) -> None:
    """500 Hz and 1 kHz, 2 ms and 100 ppm apart: said in the mapping, or found by --align."""
    tree = robot("puma")
    perfect = error(tree, tb.import_recording(two_sources(tmp_path, tree, 0, 0)))
    path = two_sources(tmp_path, tree, LATE, SKEW)
    wrong = error(tree, tb.import_recording(path))
    (recording,), cuts, found = import_and_check(path, lambda each: (tree, each), align=True)
    (clock,) = found.offsets
    assert (cuts, clock.is_drifting) == ([], True)
    assert clock.skew == pytest.approx(-SKEW, abs=5 * clock.skew_sigma)
    said = path.read_text().replace('"s"', f'"s"\noffset = {-LATE}\nskew = {SKEW}', 1)
    path.write_text(said)
    assert wrong > 3 * perfect
    assert error(tree, tb.import_recording(path)) < 1.2 * perfect
    assert error(tree, recording) < 1.2 * perfect
    (left,) = time_offsets(tree, recording)
    assert (left.is_late, left.is_drifting) == (False, False)
    assert check_recording(tree, recording).offsets == ()  # what was accepted is not held again


def test_currents_get_torque_constants_by_the_plate_and_rest_leaves_all_assumed(
    tmp_path: Path,
) -> None:
    constants = np.array([5.0, 6.0, 4.0, 3.0, 3.5, 2.5])
    for moving in (tuple(range(6)), ()):
        made = truth("ur5", 12, seconds=10.0, moving=moving)
        columns = {"t": np.arange(len(made.position)) / 500}
        columns |= {f"q{k + 1} (rad)"[: 8 if moving else 2]: q
                    for k, q in enumerate(made.position.T)}  # fmt: skip
        columns |= {f"curr_{k + 1}": i for k, i in enumerate((made.torque / constants).T)}
        assert made.wrench is not None
        names = ("Fx (N)", "Fy (N)", "Fz (N)", "Mx (Nm)", "My (Nm)", "Mz (Nm)")
        columns |= dict(zip(names, made.wrench.T, strict=True))
        np.savez(tmp_path / "log.npz", **columns)  # type: ignore[arg-type]
        folder = tmp_path / "not/yet"
        draft = guess_mapping([tmp_path / "log.npz"], folder, made.tree.names)
        found = solve_mapping(draft, folder / "mapping.toml", made.tree)
        if moving:
            np.testing.assert_allclose(found.draft.tables["torque"]["gain"], constants, rtol=0.1)
        else:
            assert found.diagnostics
            assert found.draft.key_comments["position", "unit"].startswith(ASSUMED_NOTE)


def test_places_of_several_plates_on_the_ground_are_asked(tmp_path: Path) -> None:
    """The second plate carries a tenth of a robot on a base that moves."""
    tree, made = riding(6)
    wrench = made.measured("wrench")
    columns: dict[str, Any] = {"t": made.time}
    columns |= {f"q_{n}": q for n, q in zip(made.names, made.position.T, strict=True)}
    for plate, part in enumerate((0.9, 0.1)):
        columns |= {
            f"plate{plate}_{n}": each for n, each in zip(AXES, part * wrench.T, strict=True)
        }
    np.savez(tmp_path / "log.npz", **columns)
    draft = guess_mapping([tmp_path / "log.npz"], tmp_path, made.names)
    found = solve_mapping(draft, tmp_path / "mapping.toml", tree).draft
    assert missing_keys(found) == [f"plates.plate_{k}.place" for k in range(2)]


AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def test_plates_of_equal_columns_in_two_files_stay_two(tmp_path: Path) -> None:
    """Else one would be read from the other's file."""
    for name in ("left", "right"):
        columns: dict[str, Any] = {axis: np.arange(10.0) for axis in ("t", *AXES)}
        np.savez(tmp_path / f"{name}.npz", **columns)
    draft = guess_mapping([tmp_path / "left.npz", tmp_path / "right.npz"], tmp_path)
    plates = {name: keys["source"] for name, keys in draft.tables.items() if "plates." in name}
    assert plates == {"plates.left": "left", "plates.right": "right"}
