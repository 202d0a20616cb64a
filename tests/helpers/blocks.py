"""Code blocks of the project's pages, and how a reader runs them.

Blocks of a page run one after the other in one folder. It holds the project's models, experiments
and examples, and what a reader is taken to have: FILES. A comment in the line before a block may
say

    <!-- not run: REASON -->    it needs what a test has not: hardware, a network, minutes
    <!-- shown: WHAT -->        it is no code: what is printed, or a drawing
    <!-- part of FILE -->       its lines stand in that file of the project
    <!-- ends with 1: WHY -->   its exit code is another than 0
    <!-- slow -->               it takes seconds; also <!-- slow, ends with 1: WHY -->
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed.campaigns.campaign import CampaignTables
from testbed.core.base.toml_text import validate_tables
from testbed.importing.mapping import Mapping
from testbed.lab.experiment.experiment import Experiment
from tests.helpers.command import command_line
from tests.helpers.paths import ROOT
from tests.scenarios.scenarios import result

TEMPLATES = ROOT / "docs/templates"
PAGES = [
    *(p for p in sorted((ROOT / "docs").glob("*.md")) if not (TEMPLATES / p.name).exists()),
    *sorted(TEMPLATES.glob("*.md")),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "experiments/README.md",
]
"""All that people read; what is written with the site, as it is before."""
FILES = {
    "robot.urdf": "models/puma562.urdf",
    "robot.xml": "models/puma562.xml",
    "your_robot.urdf": "tests/golden/robots/ur5.urdf",
}
"""What a reader is taken to have, and what stands for it."""
LINKED = ("models", "experiments", "examples", "docs", "tests")
FENCE = re.compile(r"(?:<!-- ([^\n]*) -->\n)?^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PLAIN = re.compile(r"(?:testbed [^|>*;&]*\n)+")
"""Commands without help of a shell."""


@dataclass(frozen=True)
class Block:
    """A code block of a page."""

    page: Path
    mark: str
    language: str
    text: str

    @property
    def code(self) -> int:
        """The exit code that is right."""
        ends = re.search(r"ends with (\d+): ", self.mark)
        return int(ends[1]) if ends else 0

    @property
    def excused(self) -> bool:
        """Whether it need not run."""
        return self.mark.startswith(("not run: ", "shown: "))


def blocks_of(page: Path) -> list[Block]:
    """All blocks of a page, in order."""
    found = FENCE.findall(page.read_text())
    return [Block(page, mark, info.split(" ")[0], text) for mark, info, text in found]


def furnish(place: Path) -> None:
    """Make a folder as a reader has it."""
    for name in LINKED:
        (place / name).symlink_to(ROOT / name)
    for name, stands_for in FILES.items():
        (place / name).write_bytes((ROOT / stands_for).read_bytes())
    for name in ("recording.parquet", "other.parquet"):
        result("puma").recording.save(place / name)


def run(page: Path, place: Path) -> None:
    """Blocks of a page, one after the other."""
    scope: dict[str, Any] = {"__name__": "page"}
    for block in blocks_of(page):
        if block.excused:
            continue
        if block.mark.startswith("part of "):
            _is_part_of(block, ROOT / block.mark.removeprefix("part of "))
        elif block.language == "python":
            exec(compile(block.text, page.name, "exec", dont_inherit=True), scope)
        elif block.language == "sh":
            shell(block.text, place, block.code)
        elif block.language == "console":
            for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
                command, _, said = part.partition("\n")
                printed = re.escape(said).replace(r"\.\.\." + "\\\n", r"(?:.*\n)*")
                assert re.fullmatch(printed, shell(f"{command}\n", place, block.code)), said
        else:
            _is_understood(tomllib.loads(block.text))


def shell(text: str, place: Path, code: int = 0) -> str:
    """What commands print; they end as they should."""
    whole = text.replace("\\\n", "")
    if PLAIN.fullmatch(whole):
        lines = [shlex.split(line, comments=True)[1:] for line in whole.splitlines()]
        all_done = [command_line(*words, cwd=place) for words in lines]
    else:
        tool = f'testbed() {{ "{sys.executable}" -m testbed "$@"; }}\n'
        around = os.environ | {"PYTHONPATH": str(ROOT)}
        all_done = [
            subprocess.run(
                ["bash", "-ec", tool + text], cwd=place, env=around, capture_output=True,
                text=True, check=False,
            )
        ]  # fmt: skip
    for done in all_done:
        assert done.returncode == code, f"{text}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return "".join(done.stdout for done in all_done)


def _is_part_of(block: Block, file: Path) -> None:
    """Its lines stand in a file, in this order; what is between dots may be left out."""
    rest = file.read_text()
    for line in block.text.splitlines():
        for piece in filter(str.strip, line.split(" #")[0].split("...")):
            assert piece.strip() in rest, f"{file}: no '{piece}'"
            rest = rest[rest.index(piece.strip()) :]


def _is_understood(content: dict[str, Any]) -> None:
    """Tables of a file, whichever its kind; an experiment's may be a part of one."""
    if "factor" in content:
        validate_tables(CampaignTables, content, "campaign")
    elif "sources" in content:
        validate_tables(Mapping, content, "mapping")
    else:
        validate_tables(Experiment, {"name": "part", "model": "robot.urdf"} | content, "experiment")
