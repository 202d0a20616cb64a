"""Every code block of every page runs, or says in a comment before it why it does not.

Blocks of a page run one after the other in one folder, as a reader would type them. The folder
holds the project's models, experiments and examples, and what a reader is taken to have:
FILES. A comment in the line before a block may say

    <!-- not run: REASON -->    it needs what a test has not: hardware, a network, minutes
    <!-- shown: WHAT -->        it is no code: what is printed, or a drawing
    <!-- part of FILE -->       its lines stand in that file of the project
    <!-- ends with 1: WHY -->   its exit code is another than 0
    <!-- slow -->               only the slow test runs it; also <!-- slow, ends with 1: WHY -->
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import testbed as tb
from testbed.campaign.campaign import CampaignTables
from testbed.experiment.comparison import ComparisonTables
from testbed.experiment.experiment import ExperimentTables
from testbed.recordings.importing.mapping import Mapping
from testbed.toml_text import checked
from tests.helpers.paths import ROOT

PAGES = [
    *sorted((ROOT / "docs").glob("*.md")),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "experiments/README.md",
]
FILES = {
    "robot.urdf": "models/puma562.urdf",
    "robot.xml": "models/puma562.xml",
    "your_robot.urdf": "tests/golden/robots/ur5.urdf",
}
"""What a reader is taken to have, and what stands for it."""
LINKED = ("models", "experiments", "examples", "docs", "tests")
ELSEWHERE = {
    "architecture.md": "tests/house/test_architecture.py: its drawings are no code",
    "README.md": "below, tests/house/test_docs.py, and .ci/run where they make environments",
    "CONTRIBUTING.md": ".ci/run",
}
"""Pages whose blocks run in tests of their own."""
FENCE = re.compile(r"(?:<!-- ([^\n]*) -->\n)?^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SECONDS = 1200
"""Most that a block takes, on a busy machine."""


@dataclass(frozen=True)
class Block:
    """A code block of a page."""

    page: Path
    mark: str
    language: str
    text: str

    @property
    def slow(self) -> bool:
        return self.mark.startswith("slow")

    @property
    def code(self) -> int:
        """The exit code that is right."""
        ends = re.search(r"ends with (\d+): ", self.mark)
        return int(ends[1]) if ends else 0

    @property
    def excused(self) -> bool:
        return self.mark.startswith(("not run: ", "shown: "))


def blocks_of(page: Path) -> list[Block]:
    found = FENCE.findall(page.read_text())
    return [Block(page, mark, info.split(" ")[0], text) for mark, info, text in found]


BLOCKS = {page: blocks_of(page) for page in PAGES if page.name not in ELSEWHERE}
RUN = {page: [b for b in found if not b.excused] for page, found in BLOCKS.items()}


def ids(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", BLOCKS, ids=ids)
def test_every_block_says_what_it_is(page: Path) -> None:
    assert page.read_text().count("\n```") == 2 * len(BLOCKS[page]), "a block that is not seen"
    for block in BLOCKS[page]:
        known = block.language in ("python", "sh", "console", "toml")
        assert known or block.excused, f"{page.name}: what is this?\n{block.text}"
        reason = block.mark.partition(": ")[2]
        assert not block.excused or len(reason) > 8, f"{page.name}: why?\n{block.text}"


@pytest.mark.parametrize("page", BLOCKS, ids=ids)
def test_no_block_hides_by_its_indent(page: Path) -> None:
    """Four blanks after an empty line are code, too, which nothing here would see."""
    prose = FENCE.sub("", page.read_text())
    assert not re.search(r"(?<=\n)\n {4,}[^\s*-]", prose)
    assert not re.search(r"\n +```", prose)


FAST = [page for page, blocks in RUN.items() if not any(b.slow for b in blocks)]
SLOW = [page for page, blocks in RUN.items() if any(b.slow for b in blocks)]


@pytest.mark.slow
@pytest.mark.parametrize("page", FAST, ids=ids)
def test_the_blocks_of_a_page_run(page: Path, place: Path) -> None:
    run(RUN[page], place)


@pytest.mark.slow
@pytest.mark.parametrize("page", SLOW, ids=ids)
def test_the_slow_blocks_of_a_page_run_too(page: Path, place: Path) -> None:
    run(RUN[page], place)


@pytest.mark.slow
def test_the_readmes_commands_run(place: Path) -> None:
    """With the reader's own robot; .ci/run does what makes environments."""
    blocks = [b for b in blocks_of(ROOT / "README.md") if b.language == "sh"]
    own = [b.text for b in blocks if b.text.startswith("testbed ")]
    assert own
    for text in own:
        shell(re.sub(r"(runs/\w+)-[0-9a-f]+", r"\1-*", text), place)  # whatever its hash is


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, puma_recording: tb.Recording) -> Path:
    """A folder as a reader has it."""
    for name in LINKED:
        (tmp_path / name).symlink_to(ROOT / name)
    for name, stands_for in FILES.items():
        (tmp_path / name).write_bytes((ROOT / stands_for).read_bytes())
    for name in ("recording.parquet", "other.parquet"):
        puma_recording.save(tmp_path / name)
    tool = tmp_path / "bin/testbed"
    tool.parent.mkdir()
    tool.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m testbed.cli "$@"\n')
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tool.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(blocks: list[Block], place: Path) -> None:
    """Blocks of a page, one after the other."""
    scope: dict[str, Any] = {"__name__": "page"}
    for block in blocks:
        if block.mark.startswith("part of "):
            is_part_of(block, ROOT / block.mark.removeprefix("part of "))
        elif block.language == "python":
            exec(compile(block.text, block.page.name, "exec", dont_inherit=True), scope)
        elif block.language == "sh":
            shell(block.text, place, block.code)
        elif block.language == "console":
            for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
                command, _, said = part.partition("\n")
                assert shell(command, place, block.code) == said
        else:
            is_understood(tomllib.loads(block.text))


def shell(text: str, place: Path, code: int = 0) -> str:
    """What commands print; they end as they should."""
    done = subprocess.run(
        ["bash", "-ec", text], cwd=place, capture_output=True, text=True, check=False,
        timeout=SECONDS,
    )  # fmt: skip
    assert done.returncode == code, f"{text}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


def is_part_of(block: Block, file: Path) -> None:
    """Its lines stand in a file, in this order; what is between dots may be left out."""
    rest = file.read_text()
    for line in block.text.splitlines():
        for piece in filter(str.strip, line.split(" #")[0].split("...")):
            assert piece.strip() in rest, f"{file}: no '{piece}'"
            rest = rest[rest.index(piece.strip()) :]


def is_understood(content: dict[str, Any]) -> None:
    """Tables of a file, whichever its kind; an experiment's may be a part of one."""
    if "factor" in content:
        checked(CampaignTables, content, "campaign")
    elif "variant" in content:
        checked(ComparisonTables, content, "comparison")
    elif "sources" in content:
        checked(Mapping, content, "mapping")
    else:
        checked(ExperimentTables, {"name": "part", "model": "robot.urdf"} | content, "experiment")
