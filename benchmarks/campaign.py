"""What a run of a campaign costs, and whether campaigns survive kills.

Kills come at random moments, to a worker or to the command; the same command is then given again
until it says that it is done.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import psutil
import typer

from benchmarks.lines import print_lines
from tests.helpers.paths import ROOT

PATIENCE = 300.0
"""Seconds after which a command hangs."""
QUICK = (
    "motion.duration=1.5",
    "motion.candidates=1",
    "simulation.warm_up=0.2",
    "simulation.step=1e-3",
    "excitation.clearance=off",
)
"""Settings of a run of a tenth of a second."""


def run_cost(seconds: float, runs: int) -> dict[str, Any]:
    """Processor time of a run, simulated and identified by both methods."""
    import testbed as tb
    from testbed.core.base.blas import one_blas_thread
    from testbed.lab.experiment.evaluate import evaluate

    words = [
        f"motion.duration={seconds}", "motion.candidates=5", "simulation.step=1e-3",
        "identification.engine=compiled",
    ]  # fmt: skip
    files = ROOT / "experiments/table6.toml"
    experiments = [tb.Experiment.from_toml(files, [*words, f"seed={k}"]) for k in range(runs)]
    short = tb.Experiment.from_toml(files, [*words, "motion.duration=2.0"])
    with one_blas_thread():
        evaluate(short, tb.record(short), threads=1)  # a worker that has lived a while
        start = time.process_time()
        recordings = [tb.record(each) for each in experiments]
        middle = time.process_time()
        pairs = zip(experiments, recordings, strict=True)
        done = [evaluate(each, recording, threads=1) for each, recording in pairs]
        end = time.process_time()
    floors = [run.metrics["wrench_floor"] for run in done if "wrench_floor" in run.metrics]
    return {
        "benchmark": "campaign run",
        "seconds": seconds,
        "runs": runs,
        "cpu_simulation": round((middle - start) / runs, 2),
        "cpu_identification": round((end - middle) / runs, 2),
        "cpu": round((end - start) / runs, 2),
        "floor": [float(f"{min(floors):.2g}"), float(f"{max(floors):.2g}")] if floors else None,
    }


def kills(who: str, moments: int, runs: int, seed: int) -> dict[str, Any]:
    """Kill -9 at random moments; the table afterwards against an undisturbed one."""
    rng = random.Random(seed)
    same = interrupted = again = 0
    with TemporaryDirectory() as name:
        place = Path(name)
        file = place / "quick.toml"
        file.write_text(
            f'name = "quick"\nexperiment = "{ROOT / "experiments/table6.toml"}"\n'
            f'set = {list(QUICK)}\nmethods = ["wrench"]\nreplicates = {runs}\n'
        )
        begun = time.perf_counter()
        if _start(file, place / "whole").wait(PATIENCE) != 0:
            raise RuntimeError("the undisturbed campaign failed")
        usual = time.perf_counter() - begun
        wanted = (place / "whole/results.parquet").read_bytes()
        for _ in range(moments):
            codes = [_killed(_start(file, place / "disturbed"), who, usual * rng.random(), rng)]
            while codes[-1] != 0 and len(codes) < 5:
                codes.append(_start(file, place / "disturbed").wait(PATIENCE))
            interrupted += codes[0] != 0
            again += len(codes) - 1
            same += (place / "disturbed/results.parquet").read_bytes() == wanted
            shutil.rmtree(place / "disturbed")
    return {
        "benchmark": "campaign kills",
        "who": who,
        "moments": moments,
        "runs": runs,
        "usual_s": round(usual, 1),
        "commands_that_ended": interrupted,
        "commands_given_again": again,
        "same_table": same,
    }


def _start(file: Path, folder: Path) -> subprocess.Popen[bytes]:
    """The command, with two workers."""
    words = ("campaign", str(file), "--out", str(folder), "--workers", "2")
    return subprocess.Popen(
        [sys.executable, "-m", "testbed", *words],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def _killed(command: subprocess.Popen[bytes], who: str, wait: float, rng: random.Random) -> int:
    """Exit code of a command of which a process is killed after a while."""
    with suppress(subprocess.TimeoutExpired):
        command.wait(wait)
    victims = [command.pid]
    if who == "worker":
        with suppress(psutil.NoSuchProcess):
            children = psutil.Process(command.pid).children(recursive=True)
            victims = [each.pid for each in children if "spawn_main" in " ".join(each.cmdline())]
    if victims:
        with suppress(ProcessLookupError):
            os.kill(rng.choice(victims), signal.SIGKILL)
    return command.wait(PATIENCE)


def main(
    moments: Annotated[int, typer.Option(min=0, help="Kills of each process.")] = 20,
    seconds: Annotated[float, typer.Option(help="Of real runs; 0 for none.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Of the moments.")] = 0,
) -> None:
    """Campaigns: a run's cost, kills of workers and commands."""
    if seconds:
        print_lines([run_cost(seconds, 8)])
    if moments:
        lines = print_lines(kills(who, moments, 150, seed) for who in ("worker", "command"))
        raise typer.Exit(int(any(line["same_table"] != moments for line in lines)))
