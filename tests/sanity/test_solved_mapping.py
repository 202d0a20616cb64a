"""A mapping that is solved says what was planted in files that the project has not made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.foreign_recordings import LAYOUTS, planted, raw_signals
from benchmarks.inverse_recordings import truth
from benchmarks.judged_mappings import judged
from testbed.errors import RecordingError
from testbed.recordings.importing.guess import guessed
from testbed.sanity.solved_mapping import ASSUMED, missing, solved

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("robot", "layout", "turn"), [("gantry", "ros", "quarter"), ("puma562", "mat", "fifteen")]
)
def test_what_was_planted_is_solved(robot: str, layout: str, turn: str, tmp_path: Path) -> None:
    """Frame, units, sense, clock, positions and torques, within what noise allows."""
    made, told = planted(robot, turn, layout, 11)
    files = LAYOUTS[layout](tmp_path, made, raw_signals(made, told), 11)
    path = tmp_path / "mapping.toml"
    answer = solved(guessed(files.paths, tmp_path, made.tree.names), path, made.tree)
    assert not missing(answer.draft)
    found = judged(robot, answer.draft.text, files, made, told)
    assert not found.wrong, (told.what, answer.draft.text)
    assert max(found.sigmas.values()) < 4
    assert not answer.warnings
    assert answer.shares[0][1] < 1e-2
    assert answer.before is not None
    assert answer.after is not None
    assert answer.after.left.max() < min(1e-2, answer.before.left.max())
    other = truth("ur5", 13, seconds=1.0).tree
    if len(other.names) == len(made.tree.names):
        draft = guessed(files.paths, tmp_path, other.names)
        with pytest.raises(RecordingError):
            solved(draft, path, other)


def test_currents_get_torque_constants_by_the_plate_and_rest_leaves_all_assumed(
    tmp_path: Path,
) -> None:
    constants = np.array([5.0, 6.0, 4.0, 3.0, 3.5, 2.5])
    for moving in (tuple(range(6)), ()):
        made = truth("ur5", 12, moving=moving)
        columns = {"t": np.arange(len(made.position)) / 500}
        columns |= {f"q{k + 1} (rad)"[: 8 if moving else 2]: q
                    for k, q in enumerate(made.position.T)}  # fmt: skip
        columns |= {f"curr_{k + 1}": i for k, i in enumerate((made.torque / constants).T)}
        assert made.wrench is not None
        names = ("Fx (N)", "Fy (N)", "Fz (N)", "Mx (Nm)", "My (Nm)", "Mz (Nm)")
        columns |= dict(zip(names, made.wrench.T, strict=True))
        np.savez(tmp_path / "log.npz", **columns)  # type: ignore[arg-type]
        folder = tmp_path / "not/yet"
        draft = guessed([tmp_path / "log.npz"], folder, made.tree.names)
        found = solved(draft, folder / "mapping.toml", made.tree)
        if moving:
            np.testing.assert_allclose(found.draft.tables["torque"]["gain"], constants, rtol=0.1)
        else:
            assert found.warnings
            assert found.draft.notes["position", "unit"].startswith(ASSUMED)
