"""All that is too slow or too statistical for the suite, one after the other, in under an hour."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from typing import Annotated

import typer

from tests.helpers.paths import ROOT

BENCHMARKS = "-m", "benchmarks"

RIVALS = "other tools"

SOUND = [f"--only={kind}" for kind in ("clean", "torques", "coarse", "squatting", "hip")]
"""Studies of coverage without a planted fault."""

CHECKS: dict[str, tuple[str, ...]] = {
    "laws, many examples": ("-m", "pytest", "-q", "-m", "not slow", "tests"),
    "statistics and documents": ("-m", "pytest", "-q", "-m", "nightly", "tests"),
    "coverage of intervals": (*BENCHMARKS, "coverage", "--runs", "40", *SOUND),
    "detection of faults": (*BENCHMARKS, "coverage", "--runs", "20", "--only", "fault"),
    "gross faults": (*BENCHMARKS, "faults", "--seconds", "20"),
    "mistakes of mappings": (*BENCHMARKS, "mistakes"),
    "solved mappings": (*BENCHMARKS, "mappings", "--count", "20"),
    "robots": (*BENCHMARKS, "robots", "--only", ".urdf"),
    "minimal sets": (*BENCHMARKS, "minimal", "--trees", "200", "--robots", "--cuts"),
    "hostile inputs": (*BENCHMARKS, "hostile", "--inputs", "200", "--kills", "20"),
    RIVALS: (*BENCHMARKS, "rivals"),
    "real robots": (*BENCHMARKS, "real"),
    "mutants": (*BENCHMARKS, "mutation", "--mutants", "100"),
}
"""What is run, by name."""


def _passed(name: str, rivals: Sequence[str]) -> bool:
    """Whether a check reached its goals; its time on the clock and last line are printed."""
    words = (*CHECKS[name], *(rivals if name == RIVALS else ()))
    start = time.monotonic()
    environment = {**os.environ, "HYPOTHESIS_PROFILE": "nightly"}
    done = subprocess.run(
        (sys.executable, *words), cwd=ROOT, env=environment, check=False,
        capture_output=True, text=True,
    )  # fmt: skip
    last = (done.stdout.strip() or done.stderr.strip()).rpartition("\n")[2]
    word = "FAILED" if done.returncode else "passed"
    print(f"{name:<26} {word} {time.monotonic() - start:6.0f} s  {last[:160]}", flush=True)
    return not done.returncode


def main(
    only: Annotated[str, typer.Option(help="Only checks whose names hold this.")] = "",
    jobs: Annotated[int, typer.Option(help="Checks at a time.")] = 2,
    docs: Annotated[bool, typer.Option("--docs", help="Write docs/rivals.md, 20 draws.")] = False,
    python: Annotated[
        list[str] | None, typer.Option(help="Other tools: as `benchmarks rivals` takes it.")
    ] = None,
) -> None:
    """All that is too slow for the suite, as one table; exit code 1 if a check fails."""
    rivals = [f"--python={each}" for each in python or ()] + ["--docs" if docs else "--draws=2"]
    names = [name for name in CHECKS if only in name]
    with ThreadPoolExecutor(jobs) as threads:
        passed = [*threads.map(_passed, names, repeat(rivals))]
    raise typer.Exit(int(not all(passed)))
