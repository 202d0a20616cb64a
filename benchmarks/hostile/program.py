"""Runs hostile inputs through the real commands, and tells how they end, class by class."""

from __future__ import annotations

import itertools
import json
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.hostile import experiments, foreign, listings, models, recordings
from benchmarks.hostile.case import Case
from benchmarks.hostile.judge import complaints
from benchmarks.hostile.worker import SECONDS
from tests.helpers.paths import ROOT

MAKERS = {
    "models": models.cases,
    "recordings": recordings.cases,
    "foreign": foreign.cases,
    "experiments": experiments.cases,
    "listings": listings.cases,
}
PATIENCE = 15 * SECONDS
"""Seconds on the clock after which a command hangs, on a machine with other work to do."""
APART = 50
"""Every so many a command runs as a process of its own."""
BATCH = 100
"""Cases that are made at once."""
RENEWED = 150
"""Commands after which a worker makes place for a new one."""


@dataclass(frozen=True)
class Outcome:
    """How one case ended.

    Attributes:
        case: The input.
        done: As `worker.carried_out` reports.
        complaints: What is wrong with it.
    """

    case: Case
    done: Mapping[str, Any]
    complaints: list[str]


class Workers:
    """Processes that carry out commands; one a thread, renewed when they die or age."""

    def __init__(self) -> None:
        self._here = threading.local()
        self._all: list[subprocess.Popen[str]] = []

    def run(self, folder: Path, words: Iterable[str]) -> dict[str, Any]:
        """A command's report, or how its worker died."""
        process = self._worker()
        assert process.stdin is not None
        assert process.stdout is not None
        late = threading.Timer(PATIENCE, process.kill)
        late.start()
        try:
            process.stdin.write(json.dumps({"folder": str(folder), "words": list(words)}) + "\n")
            process.stdin.flush()
            answer = process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        finally:
            late.cancel()
        if answer:
            found: dict[str, Any] = json.loads(answer)
            return found
        self._here.worker = None
        code = process.wait()
        return {"died": {-9: f"after {PATIENCE} s", -24: "of time"}.get(code, f"signal {-code}")}

    def _worker(self) -> subprocess.Popen[str]:
        self._here.count = getattr(self._here, "count", 0) + 1
        process = getattr(self._here, "worker", None)
        if process is None or self._here.count % RENEWED == 0:
            if process is not None:
                process.stdin.close()
                process.wait()
            process = subprocess.Popen(
                [sys.executable, "-m", "benchmarks.hostile.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                cwd=ROOT,
            )
            self._here.worker = process
            self._all.append(process)
        return process

    def close(self) -> None:
        """End them all."""
        for process in self._all:
            if process.stdin is not None:
                process.stdin.close()
            if process.stdout is not None:
                process.stdout.close()
            process.wait()


def apart(folder: Path, words: Iterable[str]) -> dict[str, Any]:
    """A command as a process of its own; its memory is not measured."""
    start = time.monotonic()
    command = [sys.executable, "-m", "testbed.cli", *words]
    try:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, check=False, timeout=PATIENCE
        )
    except subprocess.TimeoutExpired:
        return {"died": f"after {PATIENCE} s"}
    except (ValueError, OSError) as error:  # words that no command line can have
        return {
            "code": 2,
            "seconds": 0,
            "megabytes": 0,
            "stdout": "",
            "stderr": f"testbed: {error}",
        }
    if done.returncode < 0:
        return {"died": f"signal {-done.returncode}"}
    return {
        "code": done.returncode,
        "seconds": 0.0,
        "wall": time.monotonic() - start,
        "megabytes": 0.0,
        "stdout": done.stdout.decode(errors="replace"),
        "stderr": done.stderr.decode(errors="replace"),
    }


def content(folder: Path) -> dict[str, bytes]:
    """Every file of a folder by its path there; folders too."""
    paths = sorted(folder.rglob("*"))
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else b""
        for path in paths
    }


def outcome(case: Case, workers: Workers, place: Path, *, alone: bool) -> Outcome:
    """Run one case in a folder of its own."""
    folder = place / case.name
    folder.mkdir()
    for name, data in case.files.items():
        (folder / name).write_bytes(data)
    before = content(folder)
    done = apart(folder, case.words) if alone else workers.run(folder, case.words)
    found = complaints(case, done, before, content(folder))
    shutil.rmtree(folder, ignore_errors=True)
    return Outcome(case, done, found)


def run(cases: Iterable[Case], jobs: int = 1) -> Iterator[Outcome]:
    """Run cases, in their order.

    Args:
        cases: The inputs.
        jobs: Workers at a time.
    """
    workers = Workers()
    with tempfile.TemporaryDirectory() as place, ThreadPoolExecutor(jobs) as threads:
        try:
            numbered = enumerate(cases)
            while batch := list(itertools.islice(numbered, BATCH)):  # not all in memory at once
                yield from threads.map(
                    lambda one: outcome(
                        one[1], workers, Path(place), alone=one[0] % APART == APART - 1
                    ),
                    batch,
                )
        finally:
            workers.close()


def keep(found: Outcome, folder: Path) -> None:
    """Keep a failing input, with how to repeat it."""
    place = folder / found.case.name
    place.mkdir(parents=True, exist_ok=True)
    for name, data in found.case.files.items():
        (place / name).write_bytes(data)
    said = {
        "complaints": found.complaints,
        "how": found.case.how,
        "words": found.case.words,
        "done": {key: value for key, value in found.done.items() if key != "stdout"},
        "stdout": str(found.done.get("stdout", ""))[:2000],
    }
    (place / "case.json").write_text(json.dumps(said, indent=1) + "\n")


def campaign(kind: str, count: int, seed: int, jobs: int, kept: Path) -> dict[str, Any]:
    """All inputs of one kind: how many were taken, refused, and not treated well.

    Args:
        kind: Of `MAKERS`.
        count: How many.
        seed: Of all choices.
        jobs: Workers at a time.
        kept: Folder for inputs that were not treated well.
    """
    codes: Counter[str] = Counter()
    wrong: Counter[str] = Counter()
    first: dict[str, str] = {}
    slowest = largest = 0.0
    for found in run(MAKERS[kind](count, seed), jobs):
        codes[str(found.done.get("code", "died"))] += 1
        slowest = max(slowest, found.done.get("seconds", 0.0))
        largest = max(largest, found.done.get("megabytes", 0.0))
        for complaint in found.complaints:
            wrong[complaint] += 1
            first.setdefault(complaint, f"{found.case.name} ({found.case.how})")
        if found.complaints:
            keep(found, kept)
    return {
        "bench": f"hostile {kind}",
        "inputs": count,
        "seed": seed,
        "exit codes": dict(sorted(codes.items())),
        "most seconds": round(slowest, 1),
        "most megabytes": round(largest),
        "not treated well": {k: {"inputs": n, "first": first[k]} for k, n in wrong.most_common()},
    }
