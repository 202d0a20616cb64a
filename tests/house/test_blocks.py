"""Code blocks of the pages run as a reader would type them (tests/helpers/blocks.py says how)."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.recordings import formats
from tests.helpers.blocks import FENCE, PAGES, blocks_of, furnish, run, shell
from tests.helpers.ideal import ideal
from tests.helpers.paths import ROOT
from tests.helpers.runs import robot

HOW_TO = [p for p in PAGES if p.name.startswith("your-") or p.name == "extending.md"]
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


def test_no_block_escapes() -> None:
    """By its indent, its language, or an excuse without a reason."""
    for page in (p for p in PAGES if p.name not in ELSEWHERE):
        prose, blocks = FENCE.sub("", page.read_text()), blocks_of(page)
        assert not re.search(r"(?<=\n)\n {4,}[^\s*-]|\n *```", prose), page
        for block in blocks:
            known = block.language in ("python", "sh", "console", "toml")
            reason = block.mark.partition(": ")[2]
            assert len(reason) > 8 if block.excused else known, (page, block.text)


def test_a_format_of_recordings_is_one_module_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The module that docs/extending.md prints is found by its name and reads what it says."""
    text = (ROOT / "docs/extending.md").read_text()
    ((name, source),) = re.findall(r"```python file=(\S+)\n(.*?)```", text, re.DOTALL)
    (tmp_path / name).write_text(source)
    monkeypatch.setattr(formats, "__path__", [*formats.__path__, str(tmp_path)])
    recording = replace(ideal(robot("gantry"), duration=4.0), tare=None)
    columns: dict[str, Any] = recording.columns()
    np.savez(tmp_path / "r.npz", **columns)
    loaded = tb.Recording.load(tmp_path / "r.npz")
    for signal, values in recording.columns().items():
        np.testing.assert_array_equal(loaded.columns()[signal], values)
