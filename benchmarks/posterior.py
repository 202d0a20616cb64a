"""Is a model file with data never worse than the file, and do its standard deviations hold?"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import typer

import testbed as tb
from benchmarks.lines import print_lines
from testbed.bodies.posterior import Posterior, posterior, rows_of
from testbed.bodies.prediction_errors import errors_of_another
from testbed.bodies.prior import prior_of
from testbed.core.base.arrays import Array
from testbed.core.base.errors import UnseenParameters
from testbed.core.estimation.problem import Problem
from testbed.core.recordings.recording import Recording
from testbed.lab.experiment.evaluate import wrong_bodies
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT

WRONG = 0.3
"""How wrong the model file's bodies are made."""

SLOW, FAST = 0.2, 1.0
"""Times a usual speed."""

SETTINGS = tb.Settings(terms=["coulomb", "viscous", "offset"])


def slow_to_fast(seeds: range, friction: float, seconds: float = 20.0) -> dict[str, Any]:
    """Fast motion by a slow one, by torques with friction that fades out, which no model has."""
    tree = tb.load_tree(ROOT / "models/puma562.xml")
    over: dict[str, list[float]] = {}
    z: dict[str, list[Array]] = {"slow": [], "fast": [], "between": []}
    for seed in seeds:
        wrong = wrong_bodies(tree, WRONG, np.random.default_rng([seed, 17]))
        speeds = SLOW, SLOW, FAST, FAST
        made = [_recording(tree, 10 * seed + k, v, friction, seconds) for k, v in enumerate(speeds)]
        found = [_found(wrong, each) for each in made]
        problem = Problem.of(wrong, made[2], "internal", SETTINGS)
        errors = errors_of_another(problem, problem.source, found[0].models)
        for name in errors.residual:
            over.setdefault(name, []).append(errors.over_file(name))
        for name, (a, b) in zip(z, ((0, 1), (2, 3), (0, 2)), strict=True):
            apart = found[a].values - found[b].values
            z[name].append((apart / np.hypot(found[a].sigma, found[b].sigma))[: found[a].count])
    return {
        "what": "fast motion by a slow one, friction that the model lacks",
        "friction": friction,
        "seeds": len(seeds),
        "error over the file's with friction, median and most": {
            name: (float(f"{np.median(each):.3g}"), float(f"{max(each):.3g}"))
            for name, each in over.items()
        },
        "coverage": {
            name: round(float((np.abs(np.concatenate(each)) < 1.96).mean()), 3)
            for name, each in z.items()
        },
    }


def _recording(tree: tb.Tree, seed: int, speed: float, friction: float, s: float) -> Recording:
    made = measured(tree, seed, duration=s, speed=speed)
    qd = np.gradient(made.position, made.time, axis=0)
    smooth = np.array([np.convolve(each, np.ones(21) / 21, "same") for each in qd.T]).T
    more = friction * np.sign(smooth) * np.exp(-((smooth / 0.1) ** 2))
    return replace(made, torque=made.measured("torque") + more)


def _found(tree: tb.Tree, recording: Recording) -> Posterior:
    try:
        estimate = tb.identify(tree, recording, "internal", settings=SETTINGS)
    except UnseenParameters:
        estimate = None
    rows = rows_of(Problem.of(tree, recording, "internal", SETTINGS), estimate)
    return posterior(rows, prior_of(tree), estimate)


def main(
    seeds: Annotated[int, typer.Option(help="Simulated robots of each kind.")] = 20,
    first: Annotated[int, typer.Option(help="The first seed.")] = 3900,
) -> None:
    """Fast motion by a slow one with the model file as prior: errors, coverage."""
    drawn = range(first, first + seeds)
    print_lines(slow_to_fast(drawn, friction) for friction in (0.0, 1.0, 3.0))
