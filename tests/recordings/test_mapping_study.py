"""The study of mappings is a witness of its own: MuJoCo's inverse dynamics, and a strict judge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.foreign_recordings import LAYOUTS, planted, raw_signals
from benchmarks.inverse_recordings import ROBOTS, inverse, real_model, tree_of, truth
from benchmarks.judged_mappings import judged, marked, right_mapping
from testbed.dynamics.inverse_dynamics import base_wrench, joint_forces
from testbed.dynamics.motion import Motion
from testbed.recordings.importing.pieces import pieces
from tests.helpers.strategies import rngs


@given(robot=st.sampled_from(sorted(ROBOTS)), rng=rngs)
def test_a_file_that_mujoco_has_read_itself_is_the_same_robot(
    robot: str, rng: np.random.Generator
) -> None:
    tree = tree_of(robot)
    q, qd, qdd = rng.uniform(-1, 1, (3, 5, tree.n))
    torque, wrench = inverse(real_model(robot, rng, 0, 0), tree.names, q, qd, qdd)
    motion = Motion(np.arange(5) / 10, q, qd, qdd)
    np.testing.assert_allclose(torque, joint_forces(tree, motion), atol=1e-3)
    np.testing.assert_allclose(wrench, base_wrench(tree, motion), atol=1e-3)


@pytest.mark.parametrize(("robot", "layout"), [("ur5", "two_csv"), ("scara", "lerobot")])
def test_the_planted_mapping_gives_the_wrench_back_and_each_wrong_line_is_seen(
    robot: str, layout: str, tmp_path: Path
) -> None:
    """Whatever a mapping says wrongly by more than the study's goals is found, and nothing else."""
    _, told = planted(robot, "any", layout, 7)
    made = truth(robot, 7, late=told.late, seconds=4.0)
    files = LAYOUTS[layout](tmp_path, made, raw_signals(made, told), 7)
    text = right_mapping(made, files, told)
    found = judged(robot, text, files, made, told)
    assert not found.wrong
    assert max(found.errors.values()) < 1e-6
    (tmp_path / "right.toml").write_text(text)
    (recording,), _ = pieces(tmp_path / "right.toml")
    on_time = truth(robot, 7, seconds=4.0)
    assert recording.wrench is not None
    assert on_time.wrench is not None
    count = recording.samples
    ahead = on_time.position[: len(on_time.position) - count + 2, 0] - recording.position[0, 0]
    lag, inner = int(np.abs(ahead).argmin()), slice(20, count - 20)
    rest = (recording.wrench - told.zero)[inner] - on_time.wrench[lag : lag + count][inner]
    assert np.abs(rest.mean(axis=0)).max() < 1e-3 * made.weight
    assert rest.std(axis=0).max() < 6e-3 * made.weight
    turn = Rotation.from_rotvec(np.radians([0.0, 0.5, 0.0])).as_matrix()
    units = ("N", "N m") if told.units != ("N", "N m") else ("lbf", "lbf in")
    wrong: list[tuple[str, dict[str, Any]]] = [
        ("wrench", {"sense": -told.sense}), ("wrench", {"units": units}),
        ("wrench", {"turn": turn @ told.turn}),
        ("wrench", {"place": told.place + np.array([0, 0.005, 0])}),
        ("wrench", {"late": told.late + 1e-3}), ("wrench", {"zero": told.zero + 10.0}),
        ("position", {"degrees": not told.degrees}),
        ("torque", {"sign": tuple(-k for k in told.sign)}),
    ]  # fmt: skip
    for table, changed in wrong:
        other = right_mapping(made, files, replace(told, **changed))
        said = judged(robot, other, files, made, told).wrong
        assert list(said) == [table], changed
        assert not marked(other, said)
        assert marked(other.replace(f"[{table}]\n", f"[{table}]\n# ASSUMED\n"), said)
