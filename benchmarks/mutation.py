"""Small wrong changes of the project, drawn from all that mutmut makes, and whether a test fails.

mutmut learns which tests execute which function, and runs those, the quickest first. Its folder
`mutants` keeps what it found until a source or a test changes.
"""

from __future__ import annotations

import fnmatch
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.lines import print_lines
from tests.helpers.paths import ROOT

FOLDER = ROOT / "mutants"

UNSEEN = {0: "survived", 33: "no test executes it", None: "not tried", 34: "skipped"}
"""What mutmut's exit codes mean where no test has failed."""

ANY = "testbed.core.base.errors.*"
"""Mutants that are tried first: with them all are made, and the tests' functions learnt."""

GOAL = 85.0
"""Of a hundred; the suite from which this draw began saw as many."""


def mutation(count: int, seed: int, only: str, jobs: int) -> Iterator[dict[str, Any]]:
    """Survivors, then a line of all."""
    _mutmut(jobs, ANY)
    names = sorted(name for name in _exit_codes() if fnmatch.fnmatch(name, only))
    drawn = np.random.default_rng(seed).permutation(names)[:count].tolist()
    _mutmut(jobs, *drawn)
    codes = _exit_codes()
    fates = {name: UNSEEN.get(codes[name], "killed") for name in drawn}
    for name, fate in fates.items():
        if fate != "killed":
            yield {"mutant": name, "fate": fate}
    counts = Counter(fates.values())
    killed = 100 * counts["killed"] / max(len(drawn), 1)
    yield {"mutants": len(drawn), **counts, "killed [%]": round(killed, 1), "goal": GOAL}


def _mutmut(jobs: int, *names: str) -> None:
    """Run mutmut on some mutants; programs that tests start are changed, too."""
    command = (sys.executable, "-m", "mutmut", "run", "--max-children", str(jobs), *names)
    environment = {**os.environ, "PYTHONPATH": str(FOLDER)}
    subprocess.run(command, cwd=ROOT, env=environment, check=True, stdout=sys.stderr)


def _exit_codes() -> dict[str, int | None]:
    """Of every mutant by name; None where it was not tried."""
    found: dict[str, int | None] = {}
    for path in FOLDER.rglob("*.meta"):
        found |= json.loads(path.read_text())["exit_code_by_key"]
    return found


def main(
    mutants: Annotated[int, typer.Option(help="How many to draw.")] = 100,
    seed: Annotated[int, typer.Option(help="Of the draw.")] = 0,
    only: Annotated[str, typer.Option(help="Only mutants whose names match.")] = "testbed.*",
    jobs: Annotated[int, typer.Option(help="Processes at a time.")] = 1,
) -> None:
    """How many small wrong changes of the project the tests see; exit code 1 below the goal."""
    *_, found = print_lines(mutation(mutants, seed, only, jobs))
    raise typer.Exit(int(found["killed [%]"] < GOAL))
