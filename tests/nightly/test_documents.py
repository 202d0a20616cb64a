"""Figures that the README states, and every example: minutes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.nightly


def test_the_figures_of_the_readme_are_those_of_its_experiment() -> None:
    run = tb.carry_out(tb.Experiment.from_toml(ROOT / "experiments/table6.toml"))
    assert run.score is not None
    row = r"^\| (\w+) .* \| ([\d.]+|not)[^|]* \| \*\*([\d.]+)"
    said = {
        name: (torques, plate)
        for name, torques, plate in re.findall(row, (ROOT / "README.md").read_text(), re.MULTILINE)
    }
    wanted: dict[str, list[float | None]] = {name: [] for name in said}
    for method in ("torque", "wrench"):
        accuracy, errors = run.score.accuracy[method], run.score.errors[method]
        middle = np.nanmedian(np.abs(errors.relative[: run.estimates[method].minimal.count]))
        wanted["prediction"].append(accuracy.torque)
        wanted["the"].append(accuracy.wrench)
        wanted["median"].append(float(middle))
        wanted["largest"].append(run.metrics[f"{method}_max_z"] / 100)
    assert list(said) == ["prediction", "the", "median", "largest"]
    for name, cells in said.items():
        for cell, share in zip(cells, wanted[name], strict=True):
            if share is None:
                assert cell == "not"
            else:
                assert float(cell) == pytest.approx(100 * share, rel=0.05)


def test_every_example_runs_anywhere(tmp_path: Path) -> None:
    scripts = {path.name: path.read_text() for path in (ROOT / "examples").glob("*.py")}
    for path in (ROOT / "examples").glob("*.ipynb"):
        cells = json.loads(path.read_text())["cells"]
        lines = ("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
        scripts[path.name] = "\n".join(lines)
    assert len(scripts) >= 7
    for name, code in scripts.items():
        path = ROOT / "examples" / name  # a notebook has no place that it could ask for
        command = [str(path)] if path.suffix == ".py" else ["-c", code]
        done = subprocess.run(
            [sys.executable, *command], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, ""), name
        assert done.stdout.strip(), name
