"""The study of mappings judges by what a mapping means, and sees each thing that is wrong in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.foreign_recordings import LAYOUTS, Files, Planted, planted, raw_signals
from benchmarks.inverse_recordings import ROBOTS, Truth, inverse, real_model, tree_of, truth
from benchmarks.judged_mappings import judged, marked, right_mapping
from testbed.dynamics.inverse_dynamics import base_wrench, joint_forces
from testbed.dynamics.motion import Motion
from testbed.recordings.importing.pieces import pieces

SEED = 7


def some(folder: Path, robot: str = "ur5", layout: str = "mat") -> tuple[Truth, Planted, Files]:
    _, told = planted(robot, "any", layout, SEED)
    made = truth(robot, SEED, late=told.late, seconds=4.0)
    return made, told, LAYOUTS[layout](folder, made, raw_signals(made, told), SEED)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_file_that_mujoco_has_read_itself_is_the_same_robot(robot: str) -> None:
    tree, rng = tree_of(robot), np.random.default_rng(SEED)
    q, qd, qdd = rng.uniform(-1, 1, (3, 20, tree.n))
    torque, wrench = inverse(real_model(robot, rng, 0, 0), tree.names, q, qd, qdd)
    motion = Motion(np.arange(20) / 10, q, qd, qdd)
    np.testing.assert_allclose(torque, joint_forces(tree, motion), atol=1e-3)
    np.testing.assert_allclose(wrench, base_wrench(tree, motion), atol=1e-3)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("robot", ["ur5", "scara"])
def test_the_mapping_that_was_planted_is_right_and_gives_the_wrench_back(
    tmp_path: Path, robot: str, layout: str
) -> None:
    made, told, files = some(tmp_path, robot, layout)
    text = right_mapping(made, files, told)
    found = judged(robot, text, files, made, told)
    assert not found.wrong
    assert max(found.errors.values()) < 1e-6
    (tmp_path / "right.toml").write_text(text)
    (recording,), _ = pieces(tmp_path / "right.toml")
    on_time = truth(robot, SEED, seconds=4.0)
    assert recording.wrench is not None
    assert on_time.wrench is not None
    count = len(recording.time)
    lag = int(np.abs(on_time.position[: len(on_time.position) - count + 2, 0]
                     - recording.position[0, 0]).argmin())  # fmt: skip
    inner = slice(20, count - 20)
    rest = (recording.wrench - told.zero)[inner] - on_time.wrench[lag : lag + count][inner]
    assert np.abs(rest.mean(axis=0)).max() < 1e-3 * made.weight
    assert rest.std(axis=0).max() < 6e-3 * made.weight


def altered(told: Planted, what: str) -> Planted:
    turn = Rotation.from_rotvec(np.radians([0.0, 0.5, 0.0])).as_matrix()
    other: dict[str, dict[str, Any]] = {
        "sense": {"sense": -told.sense},
        "units": {"units": ("N", "N m") if told.units != ("N", "N m") else ("lbf", "lbf in")},
        "turn": {"turn": turn @ told.turn},
        "shift": {"place": told.place + np.array([0, 0.005, 0])},
        "clock": {"late": told.late + 1e-3},
        "tare": {"zero": told.zero + 10.0},
        "degrees": {"degrees": not told.degrees},
        "torque": {"sign": tuple(-k for k in told.sign)},
    }
    return replace(told, **other[what])


@pytest.mark.parametrize(
    "what", ["sense", "units", "turn", "shift", "clock", "tare", "degrees", "torque"]
)
@pytest.mark.parametrize("layout", ["two_csv", "ros"])
def test_each_wrong_line_is_seen(tmp_path: Path, layout: str, what: str) -> None:
    made, told, files = some(tmp_path, layout=layout)
    text = right_mapping(made, files, altered(told, what))
    wrong = judged("ur5", text, files, made, told).wrong
    assert list(wrong) == [{"degrees": "position", "torque": "torque"}.get(what, "wrench")]
    assert not marked(text, wrong)
    assert marked(text.replace(f"[{next(iter(wrong))}]\n", f"[{next(iter(wrong))}]\n# ASSUMED\n"),
                  wrong)  # fmt: skip


def test_the_first_joints_zero_goes_with_a_turn_about_its_axis_and_the_last_is_free(
    tmp_path: Path,
) -> None:
    made, told, files = some(tmp_path)
    first = made.tree.joints[0]
    turn = Rotation.from_rotvec(0.3 * (first.rotation @ first.axis)).as_matrix()
    place = turn @ (told.place - first.offset) + first.offset
    zero = np.r_[turn @ told.zero[:3], turn @ told.zero[3:]]
    zero[3:] += np.cross(first.offset - turn @ first.offset, zero[:3])
    both = right_mapping(made, files, replace(told, turn=turn @ told.turn, place=place, zero=zero))

    def wrong(text: str, *offset: float) -> dict[str, str]:
        said = text.replace("[position]\n", f"[position]\noffset = {list(offset)}\n")
        return judged("ur5", said, files, made, told).wrong

    assert not wrong(both, 0.3, 0, 0, 0, 0, 1.0)
    assert "wrench" in wrong(both, 0, 0, 0, 0, 0, 0)
    assert "wrench" in wrong(right_mapping(made, files, told), 0.3, 0, 0, 0, 0, 0)
    assert "position" in wrong(both, 0.3, 0, 0.1, 0, 0, 0)


def test_sigmas_are_read_from_comments(tmp_path: Path) -> None:
    made, told, files = some(tmp_path)
    rpy = Rotation.from_matrix(told.turn).as_euler("xyz", degrees=True)
    shown = ", ".join(f"{angle:.9f}" for angle in rpy + np.array([0, 0, 0.1]))
    ratio = told.map[0, :3] @ told.map[0, :3] / (told.map[3, 3:] @ told.map[3, 3:])
    text = right_mapping(made, files, told) + (
        f"# solved: rpy {shown} +- .1, .1, .1 deg\n"
        f"# ratio {np.sqrt(ratio) * 1.02:.9g} +- {np.sqrt(ratio) * 0.01:.9g}\n"
    )
    found = judged("ur5", text, files, made, told).sigmas
    assert found["turn"] == pytest.approx(1 / np.sqrt(3), rel=1e-3)
    assert found["ratio"] == pytest.approx(2, rel=0.05)
