"""What a simulated run costs beyond MuJoCo's own steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import testbed as tb
from benchmarks.lines import print_lines
from benchmarks.timing import least, peak_rss
from testbed.core.robot.model_file import ModelFile
from testbed.lab.simulation.plant import build_plant
from testbed.lab.simulation.rollout import Sampling, simulate_motion
from testbed.motion.fourier import Fourier

MODEL = Path(__file__).parents[1] / "models" / "puma562.xml"
RATE, DURATION = 1000.0, 2.0


def simulate(step: float, rounds: int = 5) -> dict[str, Any]:
    """A recording run against `mj_step` alone, per simulation step."""
    tree = tb.load_tree(MODEL)
    plant = build_plant(ModelFile(MODEL), tree, step)
    motion = Fourier(0.5, np.zeros(tree.n), np.full((tree.n, 2), 0.2), np.full((tree.n, 2), 0.1))
    steps = round(1 / (RATE * step))
    sampling = Sampling(RATE, steps, averaged=True, warm_up=0.0)
    data = mujoco.MjData(plant.model)
    count = round(DURATION / step)
    tasks = {
        "mj_step": lambda: mujoco.mj_step(plant.model, data, nstep=count),
        "run": lambda: simulate_motion(plant, tree, motion, DURATION, 100.0, sampling),
    }
    best = least(tasks, rounds)
    ns = {name: round(1e9 * seconds / count) for name, seconds in best.items()}
    return {
        "benchmark": "simulate",
        "robot": tree.name,
        "step": step,
        "ns_per_step": ns,
        "ratio": round(best["run"] / best["mj_step"], 2),
        "peak_rss_mb": round(peak_rss()),
    }


def main() -> None:
    """A recorded run against MuJoCo's bare steps."""
    print_lines(simulate(step) for step in (1e-4, 5e-4))
