"""The figures that the README and the page of claims state."""

from __future__ import annotations

import re

import numpy as np
import pytest

import testbed as tb
from tests.helpers.paths import ROOT

README = (ROOT / "README.md").read_text()
CLAIMS = (ROOT / "docs/claims.md").read_text()


@pytest.mark.slow
def test_the_figures_of_the_readme_are_those_of_its_experiment() -> None:
    run = tb.carry_out(tb.Experiment.load(ROOT / "experiments/table6.toml"))
    assert run.score is not None
    rows = re.findall(r"^\| (\w+) .* \| ([\d.]+|not)[^|]* \| \*\*([\d.]+)", README, re.MULTILINE)
    said = {name: (torques, plate) for name, torques, plate in rows}
    assert list(said) == ["prediction", "the", "median", "largest"]
    wanted: dict[str, list[float | None]] = {name: [] for name in said}
    for method in ("internal", "external"):
        accuracy, errors = run.score.accuracy[method], run.score.errors[method]
        middle = np.nanmedian(np.abs(errors.relative[: run.estimates[method].minimal.count]))
        wanted["prediction"].append(accuracy.torque)
        wanted["the"].append(accuracy.wrench)
        wanted["median"].append(float(middle))
        wanted["largest"].append(run.metrics[f"{method}_max_z"] / 100)
    for name, cells in said.items():
        for cell, share in zip(cells, wanted[name], strict=True):
            if share is None:
                assert cell == "not"
            else:
                assert float(cell) == pytest.approx(100 * share, rel=0.05)


def test_the_readme_fits_a_screen_and_a_half() -> None:
    lines = README.splitlines()
    assert len(lines) <= 120
    assert any("pip install" in line for line in lines[:40])
    assert any("import testbed as tb" in line for line in lines[:45])
    assert "pip install bedplate" not in README  # nobody has published it


@pytest.mark.parametrize("row", re.findall(r"^\| .*`.*\|$", CLAIMS, re.MULTILINE), ids=str)
def test_a_claim_names_what_checks_it(row: str) -> None:
    command = row.rstrip("| ").split("|")[-1]
    files = re.findall(r"(?:tests|experiments|docs)/[\w./-]+", command)
    files += [f"benchmarks/{name}.py" for name in re.findall(r"-m benchmarks (\w+)", command)]
    assert files or "the same" in command
    for name in files:
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize(
    "path", sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")]), ids=lambda p: p.name
)
def test_links_lead_somewhere(path: object) -> None:
    assert isinstance(path, type(ROOT))
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", path.read_text()):
        if not target.startswith("http"):
            assert (path.parent / target).exists(), f"{path.name}: {target}"
