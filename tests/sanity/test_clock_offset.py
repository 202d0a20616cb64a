"""How late a signal is: found to microseconds, taken back, and always said."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.sanity.accept import accept, accepted_import
from testbed.sanity.clock_offset import clock_offsets
from testbed.sanity.sanity import check_sanity
from tests.helpers.cases import cases
from tests.helpers.measured import measured, random_fourier
from tests.helpers.robots import random_robot
from tests.helpers.runs import robot, without

RATE, LATE, SKEW = 1000.0, 2e-3, 1e-4


def shifted(signal: Array, time: Array, late: Array | float) -> Array:
    """A signal that is late."""
    from scipy.interpolate import make_interp_spline

    found: Array = make_interp_spline(time, signal, k=5)(np.clip(time - late, time[0], time[-1]))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", cases(["puma", "ur5", "gantry", "random"], 1))
@pytest.mark.parametrize("late", [2e-3, -0.03])
def test_a_late_plate_and_late_torques_are_found(name: str, late: float) -> None:
    tree = robot(name)
    recording = measured(tree, rate=500.0, noise=0.1)
    spoiled = replace(
        recording,
        torque=shifted(recording.measured("torque"), recording.time, late),
        wrench=shifted(recording.measured("wrench"), recording.time, late / 2),
    )
    torque, wrench = clock_offsets(tree, spoiled)
    assert torque.late
    assert wrench.late
    assert not torque.drifts
    assert not wrench.drifts
    assert abs(torque.delay - late) < max(2e-5, 5 * torque.sigma)
    assert abs(wrench.delay - late / 2) < max(2e-5, 5 * wrench.sigma)


@pytest.mark.slow
def test_sigma_of_a_delay_is_honest() -> None:
    """Z of delays of random trees that are on time: about one."""
    found = []
    for seed in range(12):
        tree = random_robot(np.random.default_rng(seed), 3).tree()
        recording = measured(tree, seed, duration=10.0, rate=200.0)
        found += [(each.delay / each.sigma, each.late) for each in clock_offsets(tree, recording)]
    z = np.array([value for value, _ in found])
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.7
    assert not any(late for _, late in found)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "ur5", "gantry"])
def test_rounding_changes_no_delay(name: str) -> None:
    """Columns that others imitate, as a first rotor's, have no directions of their own."""
    tree = robot(name)
    recording = measured(tree, rate=500.0, noise=0.1)
    other = np.nextafter(recording.position, np.inf)
    for one, two in zip(
        clock_offsets(tree, recording),
        clock_offsets(tree, replace(recording, position=other)),
        strict=True,
    ):
        assert abs(one.delay - two.delay) < 1e-5 * one.sigma
        assert one.sigma == pytest.approx(two.sigma, rel=1e-5)


@pytest.mark.slow
def test_a_drift_no_clock_has_is_not_taken_for_one() -> None:
    tree = robot("puma")
    recording = without(measured(tree, rate=500.0, noise=0.1), "torque")
    late = 5e-3 * (recording.time - 10)
    (found,) = clock_offsets(
        tree,
        replace(
            recording,
            wrench=shifted(recording.measured("wrench"), recording.time, late),
        ),
    )
    assert not found.drifts


@pytest.mark.parametrize(
    ("name", "late", "degrees"),
    [("ur5", 1.3, False), ("puma", -2.4, False), ("ur5", 0.13, True)],
)
def test_a_plate_whose_clock_is_off_by_far_is_no_other_robot(
    name: str, late: float, degrees: bool
) -> None:
    """Its delay is the mapping's line, beside other cures; `align` takes it back."""
    tree = robot(name)
    recording = without(measured(tree, 4), "torque")
    inside = (recording.time > abs(late)) & (recording.time < recording.time[-1] - abs(late))
    wrench = shifted(recording.measured("wrench"), recording.time, late)[inside]
    read = replace(
        recording, time=recording.time[: len(wrench)], wrench=wrench,
        position=recording.position[inside] * (180 / np.pi if degrees else 1),
    )  # fmt: skip
    found = check_sanity(tree, read)
    assert [cure.kind for cure in found.cures] == ["late", *["degrees"] * degrees]
    ((table, key, value),) = found.cures[0].lines
    assert (table, key) == ("wrench", "delay")
    assert value == pytest.approx(late, abs=5e-3)
    with pytest.raises(RecordingError, match="delay ="):
        accept(tree, read)
    if not degrees:
        (clock,) = accept(tree, read, align=True).clocks
        assert clock.delay == pytest.approx(late, abs=max(1e-3, 5 * clock.sigma))


MAPPING = """
rate = 1000
joints = {joints}
[sources.robot]
file = "robot.npz"
rate = 500
[sources.plate]
file = "plate.npz"
time = "t"
time_unit = "s"
{clock}
[position]
source = "robot"
columns = {position}
unit = "rad"
[wrench]
source = "plate"
columns = ["w[0]", "w[1]", "w[2]", "w[3]", "w[4]", "w[5]"]
units = ["N", "N m"]
sense = "on_robot"
"""


def two_sources(folder: Path, tree: tb.Tree, *, late: float, skew: float) -> Path:
    """Encoders at 500 Hz; a plate at 1 kHz by a clock of its own, sampled as it shows."""
    rng = np.random.default_rng(3)
    motion = random_fourier(tree, rng, 1.0)
    slow, fast = np.arange(0, 20, 2e-3), np.arange(0, 20, 1e-3)
    position = motion.at(slow).q + 1e-4 * rng.normal(size=(len(slow), tree.n))
    wrench = tb.base_wrench(tree, motion.at(fast)) + tb.pedestal_wrench(tree)
    wrench = wrench + rng.normal(size=wrench.shape) * [0.5, 0.5, 0.5, 0.1, 0.1, 0.1]
    np.savez(folder / "robot.npz", q=position)
    np.savez(folder / "plate.npz", t=late + fast / (1 + skew), w=wrench)
    columns = [f"q[{k}]" for k in range(tree.n)]
    said = MAPPING.format(joints=json.dumps(tree.names), position=json.dumps(columns), clock="")
    (folder / "map.toml").write_text(said)
    return folder / "map.toml"


def error(tree: tb.Tree, recording: tb.Recording) -> float:
    """Rms of the external estimate's relative errors."""
    estimate = tb.identify(tree, recording, "external", settings=tb.Settings(noise="white"))
    true = estimate.minimal.values(tb.barycentric(tree))
    size = np.abs(true)
    for unit in set(estimate.units):
        same = np.array([each == unit for each in estimate.units])
        size[same] = np.maximum(size[same], 0.05 * size[same].max())
    return float(np.sqrt(np.mean(((estimate.values - true) / size) ** 2)))


@pytest.mark.slow
def test_two_clocks_are_as_good_as_one(tmp_path: Path) -> None:
    """500 Hz and 1 kHz, 2 ms and 100 ppm apart: said in the mapping, or found by --align."""
    tree = robot("puma")
    perfect = error(tree, tb.Recording.from_mapping(two_sources(tmp_path, tree, late=0, skew=0)))
    path = two_sources(tmp_path, tree, late=LATE, skew=SKEW)
    wrong = error(tree, tb.Recording.from_mapping(path))
    (recording,), cuts, found = accepted_import(path, tree, align=True)
    assert cuts == []
    (clock,) = found.clocks
    assert clock.drifts
    assert "ms late, and clocks differ by -1" in clock.text
    text = path.read_text()
    path.write_text(text.replace('"s"', f'"s"\noffset = {-LATE}\nskew = {SKEW}', 1))
    said = error(tree, tb.Recording.from_mapping(path))
    assert wrong > 3 * perfect
    assert said < 1.2 * perfect
    assert error(tree, recording) < 1.2 * perfect
    (left,) = clock_offsets(tree, recording)
    assert not left.late
    assert not left.drifts
