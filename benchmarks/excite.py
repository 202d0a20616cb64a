"""What designed motions gain over random ones that obey the same limits, and what they cost.

The random ones are scaled like those of an experiment and swing less until they are proven.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import testbed as tb
from benchmarks.lines import print_lines
from testbed.core.kernel.warm_up import warm_up
from testbed.lab.experiment.excite import design_problem
from testbed.motion.design import DesignProblem, criterion, design
from testbed.motion.fourier import Fourier
from testbed.motion.proof import prove, respects_limits_at_samples
from testbed.motion.random_motion import random_motion
from tests.helpers.paths import GOLDEN, ROOT

PUMA = ROOT / "models/puma562.xml"
SHARES = 0.95 ** np.arange(60)
"""Of the swing of random motions, until one is proven."""

PLATE = ("measurement.force_noise=0.5", "measurement.moment_noise=0.1", "motion.duration=10")


CASES: dict[str, tuple[Path, tuple[str, ...]]] = {
    "puma562": (PUMA, ("identification.zeros=true", "excitation.clearance=off")),
    "puma562, clear": (PUMA, ("identification.zeros=true", "excitation.starts=4")),
    "kuka_lwr4": (GOLDEN / "robots/kuka_lwr4.urdf", ("excitation.starts=2",)),
}
"""Models and settings, by what the robot is called."""


def gain(
    name: str, model: Path, settings: tuple[str, ...], seeds: int, baseline: int
) -> dict[str, Any]:
    """How many times smaller the relative sigma is than the median of random motions."""
    warm_up()
    gains, seconds = [], []
    experiment = tb.Experiment.of_model(model, [*PLATE, *settings])
    problem = design_problem(experiment)
    random = float(np.median([criterion(problem, motion) for motion in allowed(problem, baseline)]))
    for seed in range(seeds):
        start = time.process_time()
        found = design(replace(problem, seed=seed))
        seconds.append(time.process_time() - start)
        gains.append(float(np.exp((random - found.value) / 2)))
    return {
        "robot": name,
        "joints": problem.rules.tree.n,
        "seeds": seeds,
        "random": baseline,
        "gain": round(float(np.median(gains)), 2),
        "least": round(min(gains), 2),
        "cpu_seconds": round(float(np.median(seconds)), 1),
    }


def allowed(problem: DesignProblem, count: int) -> list[Fourier]:
    """Random motions of 5 harmonics of 0.1 Hz that are proven."""
    rules, rng = problem.rules, np.random.default_rng(1996)
    found: list[Fourier] = []
    while len(found) < count:
        motion = random_motion(rules.tree, rules.limits, 0.1, 5, rng)
        smaller = (motion.scaled(float(share), motion.offset) for share in SHARES)
        good = (
            m for m in smaller if respects_limits_at_samples(m, rules) and prove(m, rules).is_valid
        )
        kept = next(good, None)
        found += [] if kept is None else [kept]
    return found


def main(
    seeds: Annotated[int, typer.Option(min=1, help="Designs of each robot.")] = 10,
    baseline: Annotated[int, typer.Option(min=1, help="Random motions to compare with.")] = 40,
    model: Annotated[list[Path] | None, typer.Option(help="Another robot; again for more.")] = None,
    only: Annotated[str, typer.Option(help="Only robots whose names hold this.")] = "",
) -> None:
    """Designed motions: gain over random ones with the same limits."""
    every = CASES | {each.stem: (each, ("excitation.starts=2",)) for each in model or []}
    print_lines(gain(name, *case, seeds, baseline) for name, case in every.items() if only in name)
