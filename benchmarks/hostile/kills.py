"""Processes killed while they replace a run folder, a recording or a report."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import testbed as tb
from testbed.experiment.evaluate import evaluate
from testbed.experiment.results import write_run
from testbed.experiment.run import Run
from testbed.files import HIDDEN
from testbed.recordings.recording import Recording
from testbed.reporting.run_page import write_report
from tests.helpers.paths import GOLDEN, ROOT

DURATIONS = (1.0, 1.2)
"""Of the two runs that replace each other [s]; what is found must be of one of them."""


@cache
def made(turn: int) -> Run:
    """A short run of a pendulum."""
    experiment = tb.Experiment(
        name="pendulum",
        model=str(GOLDEN / "robots/pendulum.urdf"),
        motion={"duration": DURATIONS[turn % 2], "candidates": 1},
        simulation={"step": 1e-3},
    )
    return evaluate(experiment, tb.simulate(experiment))


def _write_recording(run: Run, place: Path) -> None:
    run.recording.save(place)


WRITERS: dict[str, Callable[[Run, Path], object]] = {
    "run": write_run,
    "recording": _write_recording,
    "report": write_report,
}
NAMES = {"run": "run", "recording": "r.parquet", "report": "report.html"}


def samples(seconds: float) -> int:
    """Of a recording at 1 kHz."""
    return round(seconds * 1000)


def check(kind: str, place: Path) -> None:
    """Whether what stands there is whole, and of one run."""
    if kind == "recording":
        assert Recording.load(place).samples in map(samples, DURATIONS)
    elif kind == "report":
        assert place.read_text().rstrip().endswith("</html>")
        assert json.loads(place.with_suffix(".json").read_text())
    else:
        said = tomllib.loads((place / "experiment.toml").read_text())["motion"]["duration"]
        recording = Recording.load(place / "recording.parquet")
        assert recording.samples == samples(said)
        assert (place / "model").is_dir()
        if (place / "result.json").exists():  # written after the others
            assert json.loads((place / "result.json").read_text())["name"] == "pendulum"


def kills(count: int, seed: int) -> dict[str, Any]:
    """Kill writers at random moments; what they were to replace must stay whole.

    Args:
        count: How many.
        seed: Of the moments.
    """
    rng = random.Random(f"{seed}/kills")
    left = 0
    broken: list[str] = []
    for number in range(count):
        kind = list(WRITERS)[number % len(WRITERS)]
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder) / NAMES[kind]
            WRITERS[kind](made(0), place)
            _kill(kind, place, rng.uniform(0.0, 0.4))
            left += any(Path(folder).rglob(f"{HIDDEN}*"))
            try:
                check(kind, place)
                WRITERS[kind](made(1), place)  # the next writer
                check(kind, place)
            except Exception as error:
                broken.append(f"{kind}, kill {number}: {type(error).__name__} {error}"[:200])
    return {
        "bench": "kills while writing",
        "kills": count,
        "left something": left,
        "not treated well": broken,
    }


def _kill(kind: str, place: Path, seconds: float) -> None:
    """Start a writer, and kill it after a while."""
    command = [sys.executable, "-m", "benchmarks.hostile.kills", kind, str(place)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(seconds)
        process.kill()


def write_for_ever(kind: str, place: Path) -> None:
    """Replace what stands there by two runs in turn."""
    made(0), made(1)
    print("here", flush=True)
    turn = 0
    while True:
        turn += 1
        WRITERS[kind](made(turn), place)


if __name__ == "__main__":
    write_for_ever(sys.argv[1], Path(sys.argv[2]))
