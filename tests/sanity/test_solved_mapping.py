"""A mapping that is solved makes recordings that are true of the robot.

`python -m benchmarks mappings` solves many robots, layouts and frames, and judges every line.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from benchmarks.inverse_recordings import truth
from testbed.recordings.importing.guess import guessed
from testbed.sanity.solved_mapping import ASSUMED, solved
from tests.scenarios.scenarios import result

pytestmark = pytest.mark.slow


def test_a_solved_mapping_tells_the_robots_parameters() -> None:
    """Witness: the robot whose motion MuJoCo made; its plate was turned, in other units, late."""
    run = result("import")
    found = run.estimates["external"]
    true = found.minimal.values(tb.barycentric(run.tree))
    assert np.abs(found.values - true).max() < 0.05 * np.abs(true).max()


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
