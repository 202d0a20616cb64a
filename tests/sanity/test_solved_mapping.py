"""A mapping that is solved says what was planted in files that the project has not made."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path

import numpy as np
import pytest

from benchmarks.foreign_recordings import LAYOUTS, TURNS, planted, raw_signals
from benchmarks.inverse_recordings import ROBOTS, truth
from benchmarks.judged_mappings import judged
from testbed.errors import RecordingError
from testbed.recordings.importing.guess import guessed
from testbed.recordings.importing.mapping import read_mapping
from testbed.sanity.solved_mapping import ASSUMED, missing, solved

CASES = [*zip(ROBOTS, cycle(LAYOUTS), cycle(TURNS), strict=False)]


@pytest.mark.parametrize(("robot", "layout", "turn"), CASES)
def test_what_was_planted_is_solved(robot: str, layout: str, turn: str, tmp_path: Path) -> None:
    """Frame, units, sense, clock, positions and torques, within what noise allows."""
    made, told = planted(robot, turn, layout, 11)
    files = LAYOUTS[layout](tmp_path, made, raw_signals(made, told), 11)
    path = tmp_path / "mapping.toml"
    answer = solved(guessed(files.paths, tmp_path, made.tree.names), path, made.tree)
    draft = answer.draft
    assert not missing(draft)
    path.write_text(draft.text)
    assert read_mapping(path)
    found = judged(robot, draft.text, files, made, told)
    assert not found.wrong, (told.what, draft.text)
    assert max(found.sigmas.values()) < 4
    assert not answer.warnings
    assert answer.shares[0][1] < 1e-2
    assert answer.after is not None
    assert answer.after.left.max() < 1e-2


@pytest.mark.parametrize("name", ["current{} (A)", "curr_{}"])
def test_currents_get_torque_constants_by_the_plate(name: str, tmp_path: Path) -> None:
    made = truth("ur5", 12)
    constants = np.array([5.0, 6.0, 4.0, 3.0, 3.5, 2.5])
    columns = {"t": np.arange(len(made.position)) / 500}
    columns |= {f"q{k + 1} (rad)": q for k, q in enumerate(made.position.T)}
    columns |= {name.format(k + 1): i for k, i in enumerate((made.torque / constants).T)}
    assert made.wrench is not None
    names = ("Fx (N)", "Fy (N)", "Fz (N)", "Mx (Nm)", "My (Nm)", "Mz (Nm)")
    columns |= dict(zip(names, made.wrench.T, strict=True))
    np.savez(tmp_path / "log.npz", **columns)  # type: ignore[arg-type]
    folder = tmp_path / "not/yet"
    draft = guessed([tmp_path / "log.npz"], folder, made.tree.names)
    draft = solved(draft, folder / "mapping.toml", made.tree).draft
    np.testing.assert_allclose(draft.tables["torque"]["gain"], constants, rtol=0.1)


def test_a_robot_at_rest_leaves_everything_assumed_and_says_so(tmp_path: Path) -> None:
    made = truth("ur5", 12, moving=())
    columns = {"t": np.arange(len(made.position)) / 500}
    columns |= {f"q{k + 1}": np.full(len(made.position), q) for k, q in enumerate(made.position[0])}
    columns |= {f"tau{k + 1}": tau for k, tau in enumerate(made.torque.T)}
    np.savez(tmp_path / "log.npz", **columns)  # type: ignore[arg-type]
    draft = guessed([tmp_path / "log.npz"], tmp_path, made.tree.names)
    found = solved(draft, tmp_path / "mapping.toml", made.tree)
    assert found.warnings
    assert found.draft.notes["position", "unit"].startswith(ASSUMED)


def test_another_robots_recording_is_refused(tmp_path: Path) -> None:
    made, told = planted("kinova", "any", "mat", 13)
    files = LAYOUTS["mat"](tmp_path, made, raw_signals(made, told), 13)
    other, _ = planted("ur5", "any", "mat", 13)
    draft = guessed(files.paths, tmp_path, other.tree.names)
    with pytest.raises(RecordingError):
        solved(draft, tmp_path / "mapping.toml", other.tree)
