"""Minimal sets: how the cost grows, and whether three witnesses agree on many trees."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import testbed as tb
from testbed.dynamics.witnesses import verify
from tests.helpers.robots import random_robot

JOINTS = (10, 25, 50, 100, 200, 400)
RUNS = 5
GRAVITIES = {"down": (0.0, 0.0, -9.81), "tilted": (2.97, -4.95, -7.93), "off": (0.0, 0.0, 0.0)}


def scaling() -> dict[str, Any]:
    """Least time for both sets with all formulas, over the number of joints [s]."""
    times = []
    for n in JOINTS:
        tree = random_robot(np.random.default_rng(n), n).tree()
        runs = []
        for _ in range(RUNS):
            start = time.perf_counter()
            for each in (tb.minimal_set(tree, "dynamic"), tb.minimal_set(tree, "reaction")):
                assert each.formulas
            runs.append(time.perf_counter() - start)
        times.append(min(runs))
        print(f"{n:4d} joints {times[-1] * 1e3:8.1f} ms")
    exponent = float(np.polyfit(np.log(JOINTS), np.log(times), 1)[0])
    print(f"cost grows with the number of joints to the power {exponent:.2f}")
    return {"benchmark": "minimal", "joints": JOINTS, "seconds": times, "exponent": exponent}


def agreement(trees: int) -> dict[str, Any]:
    """Rules, recursion and sampled regressor on random trees of 1 to 12 joints."""
    checked, failed, worst, change = 0, 0, 0.0, 0.0
    for seed in range(trees):
        rng = np.random.default_rng(seed)
        tree = random_robot(rng, int(rng.integers(1, 13))).tree()
        for gravity in GRAVITIES.values():
            sets = (
                tb.minimal_set(tree, "dynamic", gravity),
                tb.minimal_set(tree, "reaction", gravity),
                tb.minimal_set(tree, "reaction", gravity, tared=True),
            )
            for found in (verify(tree, each) for each in sets):
                checked += 1
                failed += not found.holds
                worst = max(worst, found.recursion_distance, found.sampled_distance)
                change = max(change, found.change)
    print(f"{checked} sets of {trees} trees: {failed} disagreements")
    return {
        "benchmark": "agreement",
        "trees": trees,
        "sets": checked,
        "disagreements": failed,
        "largest_distance": worst,
        "largest_change": change,
    }
