"""The complete answer: passes, solution, covariance; threads; memory; files."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import testbed as tb
from benchmarks.lines import print_lines
from benchmarks.regressor import MODELS, Case, cases, stack
from benchmarks.timing import forget_peak, least, peak_rss
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.metadata import Metadata
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import DerivedSource

EXACT = tb.Settings(position_cutoff="off", cutoff="off", deadband=0.0, terms=())
REPEATS = {"arm3": 200, "puma6": 200, "tree30": 64}
"""How many times the samples of a case make a long recording."""

LOOP = {"arm3": 16_000, "puma6": 16_000, "tree30": 1600}
"""Samples of a loop whose rows do not fit into a cache: nor do those of a long recording."""


class Endless(DerivedSource):
    """Samples made as they are asked for: a recording of any length that takes no memory."""

    def __init__(self, recording: Recording, samples: int) -> None:
        super().__init__(recording, samples, 1000.0)
        self.recording = recording

    def part(self, first: int, last: int) -> Recording:
        """The recording over and over."""
        r = self.recording
        assert r.velocity is not None
        assert r.acceleration is not None
        k = np.arange(first, last) % r.samples
        return Recording(
            r.names,
            np.arange(first, last) / self.rate,
            r.position[k],
            r.measured("torque")[k],
            r.measured("wrench")[k],
            r.velocity[k],
            r.acceleration[k],
            tare=self.tare,
        )


def answer(case: Case, model: Signal, rounds: int) -> dict[str, Any]:
    """`identify` on sensed kinematics, unfiltered, against loop and lstsq."""
    minimal = tb.minimal_set(case.tree, model)
    samples = REPEATS[case.name] * case.recording.samples  # enough to forget what starting costs
    recording = Endless(case.recording, samples).part(0, samples)
    method: Signal = "torque" if model == "torque" else "wrench"
    a, b = stack(case, minimal)
    answers: dict[str, Callable[[], object]] = {
        f"answer_{threads}": partial(
            tb.identify, case.tree, recording, method, settings=EXACT, threads=threads
        )
        for threads in (1, 2)
    }
    clock = least(answers, rounds, wall=True)
    tasks = {
        "loop": case.loop(model, LOOP[case.name]),
        "lstsq": lambda: np.linalg.lstsq(a, b, rcond=None),
        "answer": answers["answer_1"],
    }
    best = least(tasks, rounds)
    rows = len(b) // (case.tree.n if model == "torque" else 6)
    counts = {"loop": LOOP[case.name], "lstsq": rows, "answer": samples}
    ns = {name: 1e9 * t / counts[name] for name, t in best.items()}
    return {
        "benchmark": f"answer {model}",
        "robot": case.name,
        "ns_per_sample": {name: round(value, 1) for name, value in ns.items()},
        "ratio": round((ns["loop"] + ns["lstsq"]) / ns["answer"], 1),
        "two_threads": round(clock["answer_1"] / clock["answer_2"], 2),
        "peak_rss_mb": round(peak_rss()),
    }


def stored(case: Case, gigabytes: float) -> dict[str, Any]:
    """A Parquet recording larger than memory should need, encoders only, default settings."""
    import time

    from tests.helpers.parts import write_parts

    bytes_per_sample = 8 * (1 + 2 * case.tree.n + 6)
    samples = int(gigabytes * 1e9 / bytes_per_sample)
    with tempfile.TemporaryDirectory(dir=".") as folder:
        path = Path(folder) / "long.parquet"
        source = Endless(case.recording, samples)
        slow = (source.part(k, min(k + 250_000, samples)) for k in range(0, samples, 250_000))
        write_parts((_encoders(part) for part in slow), path)
        size = path.stat().st_size
        forget_peak()
        start = time.perf_counter()
        tb.identify(case.tree, path, "wrench")
        seconds = time.perf_counter() - start
    return {
        "benchmark": "stored",
        "robot": case.name,
        "samples": samples,
        "file_gb": round(size / 1e9, 2),
        "seconds": round(seconds, 1),
        "peak_rss_mb": round(peak_rss()),
    }


def _encoders(part: Recording) -> Recording:
    return replace(part, velocity=None, acceleration=None, truth=None, metadata=Metadata())


def main(
    rounds: Annotated[int, typer.Option(help="Turns that each rival has.")] = 8,
    gigabytes: Annotated[float, typer.Option(help="Size of a recording to identify.")] = 0.0,
) -> None:
    """The complete answer against Pinocchio in a loop and lstsq; threads; memory."""
    known = cases()
    if gigabytes:  # first: what a process once held stays in its peak
        print_lines([stored(known[1], gigabytes)])
    print_lines(answer(case, model, rounds) for case, model in product(known, MODELS))
