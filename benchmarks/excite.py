"""What designed motions gain over random ones that obey the same limits, and what they cost.

The random ones are scaled like those of an experiment and swing less until they are proven.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import testbed as tb
from benchmarks.lines import print_lines
from testbed.core.base.errors import InfeasibleMotion
from testbed.core.kernel.warm_up import warm_up
from testbed.lab.experiment.excite import design_problem
from testbed.motion.design import DesignProblem, criterion, design
from testbed.motion.fourier import Fourier
from testbed.motion.limits import motor_efforts
from testbed.motion.proof import Rules, prove, seems_to_hold
from testbed.motion.random_motion import random_motion

ROOT = Path(__file__).parents[1]
PUMA = ROOT / "models/puma562.xml"
GOLDEN_ARMS = [
    ROOT / f"tests/golden/robots/{name}.urdf" for name in ("ur5", "gantry_ppp_rrr", "kuka_lwr4")
]
SHARES = 0.95 ** np.arange(60)
"""Of the swing of random motions, until one is proven."""

PLATE = ("measurement.force_noise=0.5", "measurement.moment_noise=0.1", "motion.duration=10")


@dataclass(frozen=True)
class Case:
    """A robot, and whether it keeps clear."""

    name: str
    model: Path
    settings: tuple[str, ...]


def cases(models: list[Path]) -> Iterator[Case]:
    """The PUMA without and with clearance, a seven-axis arm, and what else is named."""
    zeros = "identification.zeros=true"
    yield Case("puma562", PUMA, (zeros, "excitation.clearance=off"))
    yield Case("puma562, clear", PUMA, (zeros, "excitation.starts=4"))
    yield Case("kuka_lwr4", GOLDEN_ARMS[-1], ("excitation.starts=2",))
    for model in models:
        yield Case(model.stem, model, ("excitation.starts=2",))


def gain(case: Case, seeds: int, baseline: int) -> dict[str, Any]:
    """How many times smaller the relative sigma is than the median of random motions."""
    warm_up()
    gains, seconds = [], []
    experiment = tb.Experiment.of_model(case.model, [*PLATE, *case.settings])
    problem = design_problem(experiment)
    random = float(np.median([criterion(problem, motion) for motion in allowed(problem, baseline)]))
    for seed in range(seeds):
        start = time.process_time()
        found = design(replace(problem, seed=seed))
        seconds.append(time.process_time() - start)
        gains.append(float(np.exp((random - found.value) / 2)))
    return {
        "robot": case.name,
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
        good = (m for m in smaller if seems_to_hold(m, rules) and prove(m, rules).holds)
        kept = next(good, None)
        found += [] if kept is None else [kept]
    return found


def limit_sets(model: Path, count: int) -> dict[str, Any]:
    """Designs under random limits: proven, and nowhere violated on a fine grid."""
    rng = np.random.default_rng([count, *model.name.encode()])
    tree = tb.load_tree(model)
    done, refused, violated, unproven = 0, 0, 0, 0
    for number in range(count):
        speeds = {n: float(10 ** rng.uniform(-1, 0.5)) for n in tree.names}
        accelerations = {n: float(10 ** rng.uniform(-0.5, 1)) for n in tree.names}
        efforts = rng.choice([0.0, 1.0]) * 10 ** rng.uniform(-1, 1)
        settings = [*PLATE, f"seed={number}", "excitation.starts=1", "excitation.harmonics=4"]
        settings += [f"motion.max_velocity={_table(speeds)}"]
        settings += [f"motion.max_acceleration={_table(accelerations)}"]
        settings += [f"excitation.plate_range={(1e3 * 10 ** rng.uniform(-1, 1, 6)).tolist()}"]
        if efforts:
            still = tb.Motion(np.zeros(1), *np.zeros((3, 1, tree.n)))
            size = float(efforts * (np.abs(tb.joint_forces(tree, still)).max() + 1.0))
            settings += [f"robot.joint.{name}.max_effort={size}" for name in tree.names]
        experiment = tb.Experiment.of_model(model, settings)
        try:
            problem = design_problem(experiment)
            found = design(problem)
        except InfeasibleMotion:
            refused += 1
            continue
        done += 1
        unproven += not found.proof.holds
        violated += not _respected(found.motion, problem.rules)
    return {
        "robot": model.stem,
        "sets": count,
        "designed": done,
        "refused": refused,
        "unproven": unproven,
        "violated": violated,
    }


def _table(values: dict[str, float]) -> str:
    return "{" + ", ".join(f'"{name}" = {value!r}' for name, value in values.items()) + "}"


def _respected(motion: Fourier, rules: Rules) -> bool:
    """At 10 kHz, by inverse dynamics."""
    tree, limits = rules.tree, rules.limits
    at = motion.at(np.arange(0, motion.period, 1e-4))
    inside = (at.q >= limits.low).all() and (at.q <= limits.high).all()
    slow = (np.abs(at.qd) <= limits.velocity).all()
    smooth = (np.abs(at.qdd) <= limits.acceleration).all()
    strong = (np.abs(motor_efforts(tree, at)) <= limits.effort).all()
    return bool(inside and slow and smooth and strong and seems_to_hold(motion, rules, 500))


def main(
    seeds: Annotated[int, typer.Option(min=1, help="Designs of each robot.")] = 10,
    baseline: Annotated[int, typer.Option(min=1, help="Random motions to compare with.")] = 40,
    sets: Annotated[int, typer.Option(min=0, help="Random limits for each of four robots.")] = 50,
    model: Annotated[list[Path] | None, typer.Option(help="Another robot; again for more.")] = None,
    only: Annotated[str, typer.Option(help="Only robots whose names hold this.")] = "",
) -> None:
    """Designed motions: gain over random ones, random limits respected."""
    print_lines(gain(each, seeds, baseline) for each in cases(model or []) if only in each.name)
    if sets:
        print_lines(limit_sets(path, sets) for path in (PUMA, *GOLDEN_ARMS))
