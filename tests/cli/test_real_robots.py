"""Robots of other people, as they come: `new` writes an experiment, and it runs, no file edited."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

import testbed as tb
from benchmarks.robots import MOST_SIGMAS
from testbed.lab.experiment.evaluate import evaluate
from tests.helpers.command import command_line
from tests.helpers.paths import REAL

ROBOTS = {
    "light links that rub": "xarm_description/urdf/xarm7",
    "a light gripper": "z1_description/urdf/z1",
    "a frame of 1e-9 kg": "so_arm_description/urdf/so101",
    "tool frames without inertia": "talos_data/robots/talos_left_arm",
    "moments of -2e-22": "anymal_b_simple_description/robots/anymal",
    "two arms, two grippers": "baxter_description/urdf/baxter",
    "a hand, links that break the triangle": "allegro_hand_description/urdf/allegro_left_hand",
    "a gripper that touches": "ur_description/urdf/ur5_gripper",
    "a small finger": "finger_edu_description/robots/finger_edu",
    "joints without limits": "double_pendulum_description/urdf/double_pendulum_continuous",
}
SHORT, LONG = 4.0, 10.0
"""Seconds that most are recorded for, and a period that is usual."""


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_any_robot_runs_as_new_writes_it(robot: str, tmp_path: Path) -> None:
    """Else whoever has another robot than ours stops at the second command."""
    made = command_line("new", str(REAL / f"{robot}.urdf"), "--out", "r.toml", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    motion = tomllib.loads((tmp_path / "r.toml").read_text())["motion"]
    period = 1 / motion["fundamental"]  # of many parameters only a whole one holds enough values
    seconds = period if period > LONG else SHORT
    # distances to meshes take most of the time, and `new` has looked at them
    words = [f"motion.duration={seconds}", "motion.candidates=1", "excitation.clearance=off"]
    experiment = tb.Experiment.load(tmp_path / "r.toml", words)
    run = evaluate(experiment, tb.record(experiment))
    assert 0 < run.metrics["external_max_z"] < MOST_SIGMAS
