"""Is a model file with data never worse than the file, and do its standard deviations hold?"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import testbed as tb
from testbed.bodies.posterior import Posterior, posterior, rows_of
from testbed.bodies.prior import prior_of
from testbed.core.base.arrays import Array
from testbed.core.base.errors import UnseenParameters
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.selection.prediction_errors import errors_of_another
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
    """Fast motion by a slow one, by torques with friction that fades out, which no model has.

    Args:
        seeds: Of motions, noise and wrong bodies.
        friction: Of what fades out at 0.1 rad/s, in N m, at every joint.
        seconds: Of every recording.
    """
    tree = tb.load_tree(ROOT / "models/puma562.xml")
    over: dict[str, list[float]] = {}
    worst, groups = [], {"slow": ([], []), "fast": ([], [])}  # type: ignore[var-annotated]
    for seed in seeds:
        wrong = wrong_bodies(tree, WRONG, np.random.default_rng([seed, 17]))
        made = [_recording(tree, 10 * seed + k, SLOW, friction, seconds) for k in range(2)]
        other = [_recording(tree, 10 * seed + k, FAST, friction, seconds) for k in (2, 3)]
        slow, fast = ([_found(wrong, each) for each in group] for group in (made, other))
        estimate, found = slow[0]
        models = found.models | ({} if estimate is None else {"plain": estimate.values})
        problem = Problem.of(wrong, other[0], "internal", SETTINGS)
        errors = errors_of_another(problem, problem.source, models)
        for name in errors.residual:
            over.setdefault(name, []).append(errors.over_file(name))
        worst.append(float((errors.residual["posterior"] / errors.residual["refitted"]).max()))
        for name, pair in (("slow", slow), ("fast", fast)):
            for which, values in zip((0, 1), groups[name], strict=True):
                values += _apart(*(each[which] for each in pair))
        groups.setdefault("between", ([], []))
        for which, values in zip((0, 1), groups["between"], strict=True):
            values += _apart(slow[0][which], fast[0][which])
    return {
        "what": "fast motion by a slow one, friction that the model lacks",
        "friction": friction,
        "seeds": len(seeds),
        "error over the file's with friction, median": {
            name: float(f"{np.median(each):.3g}") for name, each in over.items()
        },
        "most": {name: float(f"{max(each):.3g}") for name, each in over.items()},
        "worst channel": float(f"{max(worst):.3g}"),
        "coverage, rms z: plain; posterior": {
            name: [_coverage(values) for values in pair] for name, pair in groups.items()
        },
    }


def _recording(tree: tb.Tree, seed: int, speed: float, friction: float, s: float) -> Recording:
    made = measured(tree, seed, duration=s, speed=speed)
    qd = np.gradient(made.position, made.time, axis=0)
    smooth = np.array([np.convolve(each, np.ones(21) / 21, "same") for each in qd.T]).T
    more = friction * np.sign(smooth) * np.exp(-((smooth / 0.1) ** 2))
    assert made.torque is not None
    return replace(made, torque=made.torque + more)


def _found(tree: tb.Tree, recording: Recording) -> tuple[Estimate | None, Posterior]:
    try:
        estimate = tb.identify(tree, recording, "internal", settings=SETTINGS)
    except UnseenParameters:
        estimate = None
    rows = rows_of(Problem.of(tree, recording, "internal", SETTINGS), estimate)
    return estimate, posterior(rows, prior_of(tree), estimate)


def _apart(one: Estimate | Posterior | None, other: Estimate | Posterior | None) -> list[float]:
    """Differences of two estimates of the bodies in their standard deviations."""
    if one is None or other is None:
        return []
    count = one.count if isinstance(one, Posterior) else one.minimal.count
    spread: Array = np.hypot(one.sigma, other.sigma)[:count]
    return [float(z) for z in (one.values - other.values)[:count] / spread]


def _coverage(z: list[float]) -> tuple[float, float]:
    """Share within 1.96, and rms."""
    values = np.array(z)
    return round(float((np.abs(values) < 1.96).mean()), 3), round(
        float(np.sqrt((values**2).mean())), 2
    )
