"""Code blocks of the pages run as a reader would type them (tests/helpers/blocks.py says how)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.helpers.blocks import PAGES, blocks_of, furnish, run, shell
from tests.helpers.paths import ROOT

HOW_TO = [
    ROOT / f"docs/{name}.md"
    for name in (
        *("which-sensor", "your-robot", "your-recording", "your-plate", "payload", "drives"),
        *("instruments", "extending", "python"),
    )
]
"""Pages whose blocks run with all tests."""
ELSEWHERE = ("README.md", "CONTRIBUTING.md", "architecture.md")
"""README's blocks run below; others make environments (.ci/run), or are no code."""
OTHERS = [p for p in PAGES if p not in HOW_TO and p.name not in ELSEWHERE]


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [*HOW_TO, *(pytest.param(p, marks=pytest.mark.nightly) for p in OTHERS)], ids=str
)
def test_what_a_page_tells_to_type_does_what_it_says(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    furnish(tmp_path)
    monkeypatch.chdir(tmp_path)
    run(page, tmp_path)


@pytest.mark.nightly
def test_what_the_readme_tells_to_type_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the reader's own robot; .ci/run does what makes environments."""
    furnish(tmp_path)
    monkeypatch.chdir(tmp_path)
    for block in blocks_of(ROOT / "README.md"):
        if block.text.startswith("testbed "):
            shell(re.sub(r"(runs/\w+)-[0-9a-f]+", r"\1-*", block.text), tmp_path)
        elif block.language == "python":
            exec(compile(block.text, "README.md", "exec"), {})
