"""All that is too slow or too statistical for the suite, one after the other, in under an hour."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat

from tests.helpers.paths import ROOT

BENCHMARKS = "-m", "benchmarks"

RIVALS = "other tools"

CHECKS: dict[str, tuple[str, ...]] = {
    "laws, many examples": ("-m", "pytest", "-q", "-m", "not slow", "tests"),
    "statistics and documents": ("-m", "pytest", "-q", "-m", "nightly", "tests"),
    "coverage of intervals": (*BENCHMARKS, "coverage", "--runs", "40"),
    "detection of faults": (*BENCHMARKS, "detection", "--runs", "20"),
    "gross faults": (*BENCHMARKS, "faults", "--seconds", "20"),
    "mistakes of mappings": (*BENCHMARKS, "mistakes", "--count", "30"),
    "solved mappings": (*BENCHMARKS, "mappings", "--count", "20"),
    "odd mappings": (*BENCHMARKS, "mappings", "--odd"),
    "robots": (*BENCHMARKS, "robots", "--only", ".urdf"),
    "minimal sets": (*BENCHMARKS, "minimal", "--trees", "200", "--robots", "--cuts"),
    "hostile inputs": (*BENCHMARKS, "hostile", "--inputs", "200", "--kills", "20"),
    RIVALS: (*BENCHMARKS, "rivals"),
    "mutants": (*BENCHMARKS, "mutation", "--mutants", "100"),
}
"""What is run, by name."""


@dataclass(frozen=True)
class Outcome:
    """How a check ended.

    Attributes:
        name: Of the check.
        passed: Whether it reached its goals.
        seconds: On the clock.
        last: The last line that it printed.
    """

    name: str
    passed: bool
    seconds: float
    last: str


def nightly(only: str, jobs: int, rivals: Sequence[str]) -> Iterator[Outcome]:
    """Outcomes, in the order of `CHECKS`.

    Args:
        only: Checks whose names hold this.
        jobs: Checks at a time.
        rivals: Options of the comparison with other tools.
    """
    names = [name for name in CHECKS if only in name]
    with ThreadPoolExecutor(jobs) as threads:
        yield from threads.map(_outcome, names, repeat(rivals))


def _outcome(name: str, rivals: Sequence[str]) -> Outcome:
    words = (*CHECKS[name], *(rivals if name == RIVALS else ()))
    start = time.monotonic()
    environment = {**os.environ, "HYPOTHESIS_PROFILE": "nightly"}
    done = subprocess.run(
        (sys.executable, *words), cwd=ROOT, env=environment, check=False,
        capture_output=True, text=True,
    )  # fmt: skip
    lines = (done.stdout.strip() or done.stderr.strip()).splitlines() or [""]
    return Outcome(name, done.returncode == 0, time.monotonic() - start, lines[-1])
