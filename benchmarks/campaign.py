"""What campaigns cost beyond their runs, and whether they survive kills.

Kills come at random moments, to a worker, to a scheduler of its own, or to the command; the same
command is then given again until it says that it is done.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import psutil

from benchmarks.campaign_works import WORKS
from testbed.campaigns.campaign import Campaign
from testbed.campaigns.cluster import local_workers
from testbed.campaigns.conduct import conduct

ROOT = Path(__file__).parents[1]
WORKERS = 2
IDLE = 0.5
"""Load under which a machine counts as ours alone."""

PATIENCE = 300.0
"""Seconds after which a command hangs."""


def campaign_of(folder: Path, runs: int) -> Path:
    """A campaign of so many runs.

    Args:
        folder: Where its file goes.
        runs: How many.
    """
    path = folder / "engine.toml"
    path.write_text(
        f'name = "engine"\nexperiment = "{ROOT / "experiments/table6.toml"}"\n'
        f'methods = ["external"]\nreplicates = {runs}\n'
    )
    return path


def overhead(runs: int) -> dict[str, Any]:
    """Client, scheduler and table of trivial runs.

    Args:
        runs: How many.
    """
    with TemporaryDirectory() as name:
        campaign = Campaign.load(campaign_of(Path(name), runs))
        with local_workers(1, WORKS["trivial"]) as engine:
            start, wall = time.process_time(), time.perf_counter()
            conduct(campaign, Path(name) / "out", engine)
            taken, wall = time.process_time() - start, time.perf_counter() - wall
        size = (Path(name) / "out/results.parquet").stat().st_size
    return {
        "benchmark": "campaign overhead",
        "runs": runs,
        "cpu_ms_per_run": round(1e3 * taken / runs, 3),
        "wall_s": round(wall, 1),
        "peak_rss_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "table_mb": round(size / 1e6, 1),
    }


def speedup(runs: int) -> dict[str, Any]:
    """Two workers against one, on runs that only compute.

    Args:
        runs: How many, of 0.2 s.
    """
    load = os.getloadavg()[0]
    taken = {}
    with TemporaryDirectory() as name:
        campaign = Campaign.load(campaign_of(Path(name), runs))
        for workers in (1, 2):
            with local_workers(workers, WORKS["busier"]) as engine:
                start = time.perf_counter()
                conduct(campaign, Path(name) / str(workers), engine)
                taken[workers] = time.perf_counter() - start
    return {
        "benchmark": "campaign speedup",
        "runs": runs,
        "seconds": {str(k): round(v, 1) for k, v in taken.items()},
        "ratio": round(taken[1] / taken[2], 2),
        "load_before": round(load, 1),
        "machine_was_ours": load < IDLE,
    }


def run_cost(seconds: float, together: int) -> dict[str, Any]:
    """Processor time of a run, simulated beside others and identified by both methods.

    Args:
        seconds: Of the motion.
        together: Runs side by side.
    """
    import testbed as tb
    from testbed.core.base.blas import one_blas_thread
    from testbed.lab.experiment.evaluate import evaluate

    words = [
        f"motion.duration={seconds}", "motion.candidates=5", "simulation.step=1e-3",
        "identification.engine=compiled",
    ]  # fmt: skip
    files = ROOT / "experiments/table6.toml"
    runs = [tb.Experiment.load(files, [*words, f"seed={k}"]) for k in range(together)]
    short = tb.Experiment.load(files, [*words, "motion.duration=2.0"])
    with one_blas_thread():
        evaluate(short, tb.record(short), threads=1)  # a worker that has lived a while
        start = time.process_time()
        recordings = [tb.record(run) for run in runs]
        middle = time.process_time()
        done = [
            evaluate(e, r, threads=1)
            for e, r in zip(runs, recordings, strict=True)
            if isinstance(r, tb.Recording)
        ]
        end = time.process_time()
    floors = [run.metrics["external_floor"] for run in done if "external_floor" in run.metrics]
    return {
        "benchmark": "campaign run",
        "seconds": seconds,
        "together": together,
        "cpu_simulation": round((middle - start) / together, 2),
        "cpu_identification": round((end - middle) / together, 2),
        "cpu": round((end - start) / together, 2),
        "floor": [float(f"{min(floors):.2g}"), float(f"{max(floors):.2g}")] if floors else None,
    }


@dataclass(frozen=True)
class Scene:
    """Where a campaign is carried out and somebody is killed.

    Attributes:
        file: Of the campaign.
        folder: Its folder.
        workers: How many, or the address of a scheduler.
    """

    file: Path
    folder: Path
    workers: str

    def start(self) -> subprocess.Popen[bytes]:
        """The command."""
        words = (str(self.file), str(self.folder), "busy", self.workers)
        return subprocess.Popen(
            [sys.executable, "-m", "benchmarks.campaign_works", *words],
            cwd=ROOT,
            stderr=subprocess.DEVNULL,
        )


def kills(who: str, moments: int, runs: int, seed: int) -> dict[str, Any]:
    """Kill -9 at random moments; the table afterwards against an undisturbed one.

    Args:
        who: "worker", "scheduler" or "command".
        moments: How often.
        runs: Of the campaign.
        seed: Of the moments.
    """
    rng = random.Random(seed)
    same = interrupted = again = 0
    with TemporaryDirectory() as name:
        place = Path(name)
        file = campaign_of(place, runs)
        begun = time.perf_counter()
        if Scene(file, place / "whole", str(WORKERS)).start().wait(PATIENCE) != 0:
            raise RuntimeError("the undisturbed campaign failed")
        usual = time.perf_counter() - begun
        wanted = (place / "whole/results.parquet").read_bytes()
        for _ in range(moments):
            folder = place / "disturbed"
            codes = _disturbed(file, folder, who, usual * rng.random(), rng)
            interrupted += codes[0] != 0
            again += len(codes) - 1
            same += (folder / "results.parquet").read_bytes() == wanted
            shutil.rmtree(folder)
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


def _disturbed(file: Path, folder: Path, who: str, moment: float, rng: random.Random) -> list[int]:
    """A campaign with one kill; exit codes until it is done."""
    codes = []
    with ExitStack() as stack:
        address = str(WORKERS)
        scheduler = None
        if who == "scheduler":
            address, scheduler = stack.enter_context(cluster(WORKERS))
        command = Scene(file, folder, address).start()
        deadline = time.perf_counter() + moment
        with suppress(subprocess.TimeoutExpired):
            command.wait(max(deadline - time.perf_counter(), 0))
        victim = scheduler if scheduler is not None else _victim(command.pid, who, rng)
        if victim is not None:
            with suppress(ProcessLookupError):
                os.kill(victim, signal.SIGKILL)
        codes.append(command.wait(PATIENCE))
    while codes[-1] != 0 and len(codes) < 5:
        codes.append(Scene(file, folder, str(WORKERS)).start().wait(PATIENCE))
    return codes


def _victim(command: int, who: str, rng: random.Random) -> int | None:
    """Whom to kill."""
    if who == "command":
        return command
    try:
        children = psutil.Process(command).children(recursive=True)
    except psutil.NoSuchProcess:
        return None
    workers = []
    for child in children:
        with suppress(psutil.NoSuchProcess, psutil.AccessDenied):
            if "spawn_main" in " ".join(child.cmdline()):
                workers.append(child.pid)
    return rng.choice(workers) if workers else None


@contextmanager
def cluster(
    workers: int, protocol: str = "tcp", options: Sequence[str] = ()
) -> Iterator[tuple[str, int]]:
    """`dask scheduler` and `dask worker` on the loopback, as a person starts them.

    Args:
        workers: How many of the latter.
        protocol: "tcp" or "tls".
        options: Of both, for TLS.

    Yields:
        The scheduler's address and process id.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"{protocol}://127.0.0.1:{port}"
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    dask = [sys.executable, "-m", "dask"]
    host = ["--dashboard-address", "127.0.0.1:0", *options]
    host += ["--host", f"{protocol}://127.0.0.1" if options else "127.0.0.1"]
    words = [
        [*dask, "scheduler", "--port", str(port), *host],
        *[[*dask, "worker", address, "--nthreads", "1", *host]] * workers,
    ]
    how: dict[str, Any] = {"cwd": ROOT, "start_new_session": True} | quiet
    processes = [subprocess.Popen(each, **how) for each in words]
    try:
        yield address, processes[0].pid
    finally:
        for process in processes:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
