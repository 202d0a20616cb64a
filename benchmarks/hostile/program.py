"""Runs hostile inputs through the real commands, in a process of their own that may die."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any

import hypothesis

from benchmarks.hostile.case import Case, write_files
from benchmarks.hostile.inputs import KINDS
from benchmarks.hostile.judge import complaints
from benchmarks.hostile.worker import SECONDS
from tests.helpers.paths import ROOT

PATIENCE = 15 * SECONDS
"""Seconds on the clock after which a command hangs, on a machine with other work to do."""

RENEWED = 150
"""Commands after which a worker makes place for a new one."""


class Worker:
    """A process that carries out commands; a new one when it dies or ages."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._count = 0
        self.refused = 0

    def __enter__(self) -> Worker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self._end()

    def complaints(self, case: Case) -> list[str]:
        """What is wrong with how a command takes a case, in a folder of its own."""
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            write_files(folder, case.files, case.links)
            before = _content(folder)
            done = self._run(folder, case.words)
            self.refused += done.get("code") == 2
            return complaints(case, done, before, _content(folder))

    def _run(self, folder: Path, words: Iterable[str]) -> dict[str, Any]:
        """A command's report, or how the process died."""
        if self._process is None or self._count >= RENEWED:
            self._end()
            command = [sys.executable, "-m", "benchmarks.hostile.worker"]
            self._process, self._count = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
            ), 0  # fmt: skip
        process, self._count = self._process, self._count + 1
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
        self._process = None
        return {"died": f"signal {-process.wait()}"}

    def _end(self) -> None:
        if self._process is not None:
            self._process.communicate()
            self._process = None


class _TimeIsUp(KeyboardInterrupt):
    """End of the time; Hypothesis lets an interrupt pass without looking for a smaller input."""


def hostile(
    worker: Worker, kind: str, count: int, seed: int, seconds: float = math.inf
) -> dict[str, Any]:
    """Many inputs of one kind, and the smallest that is not treated well.

    Args:
        worker: Process that carries out the commands.
        kind: Of `KINDS`.
        count: How many.
        seed: Of all choices.
        seconds: After which no further input is tried.
    """
    met, said, end, before = 0, "", time.monotonic() + seconds, worker.refused
    settings = hypothesis.settings(
        max_examples=count, deadline=None, database=None, derandomize=False, print_blob=False,
        suppress_health_check=list(hypothesis.HealthCheck),
    )  # fmt: skip

    @hypothesis.seed(seed)
    @settings
    @hypothesis.given(KINDS[kind])
    def is_treated_well(case: Case) -> None:
        nonlocal met, said
        if time.monotonic() > end and not said:
            raise _TimeIsUp
        met += 1
        if wrong := worker.complaints(case):
            said = f"{wrong}: {' '.join(case.words)} with {case.files}"[:2000]
        assert not wrong

    wrong = ""
    try:
        is_treated_well()
    except (AssertionError, hypothesis.errors.Flaky):  # time on the clock differs each time
        wrong = said
    except _TimeIsUp:
        pass
    return {"bench": f"hostile {kind}", "inputs": met, "refused": worker.refused - before,
            "seed": seed, "not treated well": wrong}  # fmt: skip


def _content(folder: Path) -> dict[str, bytes]:
    """Every file of a folder by its path there; folders too."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else b""
        for path in sorted(folder.rglob("*"))
    }
