"""The figures that the README and the page of claims state."""

from __future__ import annotations

import re

import pytest

import testbed as tb
from testbed.experiment.evaluate import evaluate
from tests.helpers.paths import ROOT

README = (ROOT / "README.md").read_text()
CLAIMS = (ROOT / "docs/claims.md").read_text()


@pytest.mark.slow
def test_the_figures_of_the_readme_are_those_of_its_experiment() -> None:
    experiment = tb.Experiment.load(ROOT / "experiments/table6.toml")
    metrics = evaluate(experiment, tb.simulate(experiment)).metrics
    rows = re.findall(r"^\| (error|largest).* \| ([\d.]+).* \| \*\*([\d.]+)", README, re.MULTILINE)
    assert [row[0] for row in rows] == ["error", "largest"]
    (_, *errors), (_, *sizes) = rows
    for said, method in zip(errors, ("internal", "external"), strict=True):
        assert float(said) == pytest.approx(100 * metrics[f"{method}_rms_relative_error"], rel=0.05)
    for said, method in zip(sizes, ("internal", "external"), strict=True):
        assert float(said) == pytest.approx(metrics[f"{method}_max_z"], rel=0.05)


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
