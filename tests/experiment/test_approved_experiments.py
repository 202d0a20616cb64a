"""The file that `testbed new` writes for robots of all kinds, as approved."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.helpers.approved import hold
from tests.helpers.command import command_line
from tests.helpers.paths import REAL
from tests.helpers.runs import MODELS

pytestmark = pytest.mark.slow

ROBOTS = dict(MODELS) | {
    "panda": REAL / "panda_description/urdf/panda.urdf",
    "g1": REAL / "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "kinova": REAL / "kinova_description/robots/kinova.urdf",
}


@pytest.mark.parametrize("name", ROBOTS)
def test_a_new_experiment_is_as_approved(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    model = ROBOTS[name]
    if not model.is_relative_to(REAL):  # these need the meshes beside them
        model = Path(shutil.copy(model, tmp_path))
    done = command_line("new", str(model), "--out", "made.toml", cwd=tmp_path)
    text = f"{done.stdout}{done.stderr}{done.returncode}\n{(tmp_path / 'made.toml').read_text()}"
    lines = [line for line in text.splitlines() if not line.startswith("model = ")]
    hold(
        f"new_{name}.txt", "\n".join(lines).replace(str(REAL), "").replace(str(tmp_path), "") + "\n"
    )
