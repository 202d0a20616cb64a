"""A mapping that is solved makes recordings that are true of the robot.

`python -m benchmarks mappings` solves many robots, layouts and frames, and judges every line.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from benchmarks.inverse_recordings import truth
from testbed.importing.check.mapping_solution import ASSUMED, missing, solve_mapping
from testbed.importing.guess import guessed
from tests.helpers.riding import riding
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
        found = solve_mapping(draft, folder / "mapping.toml", made.tree)
        if moving:
            np.testing.assert_allclose(found.draft.tables["torque"]["gain"], constants, rtol=0.1)
        else:
            assert found.diagnostics
            assert found.draft.notes["position", "unit"].startswith(ASSUMED)


@pytest.mark.parametrize("plates", [1, 2])
def test_a_bases_unit_and_quaternion_are_solved_and_places_of_several_plates_are_asked(
    plates: int, tmp_path: Path
) -> None:
    """Seven numbered columns of the pose, in mm and x, y, z, w; the second plate has a tenth."""
    tree, made = riding(6)
    pose, wrench = made.measured("base"), made.measured("wrench")
    columns: dict[str, Any] = {"t": made.time}
    columns |= {f"q_{n}": q for n, q in zip(made.names, made.position.T, strict=True)}
    turned = np.column_stack([1e3 * pose[:, :3], pose[:, [4, 5, 6, 3]]])
    columns |= {f"base_{k}": each for k, each in enumerate(turned.T)}
    for plate, part in enumerate((0.9, 0.1)[:plates]):
        columns |= {
            f"plate{plate}_{n}": each for n, each in zip(AXES, part * wrench.T, strict=True)
        }
    np.savez(tmp_path / "log.npz", **columns)
    draft = guessed([tmp_path / "log.npz"], tmp_path, made.names)
    found = solve_mapping(draft, tmp_path / "mapping.toml", tree).draft
    if plates == 2:
        assert missing(found) == [f"plates.plate_{k}.place" for k in range(2)]
        return
    assert not missing(found)
    assert found.tables["base"]["unit"] == "mm"
    assert found.tables["base"]["quaternion"] == [f"base_{k}" for k in (6, 3, 4, 5)]


AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def test_plates_of_equal_columns_in_two_files_stay_two(tmp_path: Path) -> None:
    """Else one would be read from the other's file."""
    for name in ("left", "right"):
        columns: dict[str, Any] = {axis: np.arange(10.0) for axis in ("t", *AXES)}
        np.savez(tmp_path / f"{name}.npz", **columns)
    draft = guessed([tmp_path / "left.npz", tmp_path / "right.npz"], tmp_path)
    plates = {name: keys["source"] for name, keys in draft.tables.items() if "plates." in name}
    assert plates == {"plates.left": "left", "plates.right": "right"}
