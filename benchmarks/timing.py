"""Rivals timed in turns in one process: the least time of each, and ratios of those."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numba import njit


def least(
    tasks: Mapping[str, Callable[[], object]], rounds: int, wall: bool = False
) -> dict[str, float]:
    """Least time of each task [s]; the tasks take turns, so that all see the same weather."""
    clock = time.perf_counter if wall else time.thread_time
    best = dict.fromkeys(tasks, np.inf)
    for _ in range(rounds):
        for name, task in tasks.items():
            start = clock()
            task()
            best[name] = min(best[name], clock() - start)
    return best


def forget_peak() -> None:
    """Start anew to watch how much memory this process holds."""
    Path("/proc/self/clear_refs").write_text("5")


def peak_rss() -> float:
    """Most memory this process held since `forget_peak` [MiB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


@njit(fastmath={"contract"})
def _horner(x, y, repeats):  # type: ignore[no-untyped-def]
    for _ in range(repeats):
        for k in range(256):
            v = x[k]
            a, b, c, d = 1.0, 2.0, 3.0, 4.0
            for _ in range(16):
                a = a * v + 0.5
                b = b * v + 0.25
                c = c * v + 0.125
                d = d * v + 0.75
            y[k] = a + b + c + d


def peak_flops() -> float:
    """Multiply-adds a second that one core does, each counted as two [1/s]."""
    x, y = np.full(256, 0.5), np.empty(256)
    _horner(x, y, 1)
    repeats = 200
    seconds = least({"peak": lambda: _horner(x, y, repeats)}, 50)["peak"]
    return 2 * 64 * 256 * repeats / seconds
