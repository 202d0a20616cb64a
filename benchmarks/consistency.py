"""Do consistent bodies cost accuracy, and save it where data are poor?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import numpy as np
import typer

import testbed as tb
from benchmarks.lines import print_lines
from testbed.bodies.consistency.consistent import consistent
from testbed.bodies.prior import PriorBodies, prior_of
from testbed.core.base.arrays import Array
from testbed.core.base.errors import UnidentifiableParameters
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.rules import SIGNALS
from testbed.lab.experiment.evaluate import perturbed_robot
from testbed.lab.experiment.score import finite_rms, relative_errors
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT
from tests.helpers.robots import random_robot

PRIOR = 0.3
"""How wrong the model file's bodies are made."""

Errors = dict[str, list[tuple[float, float]]]
"""Plain and consistent errors by estimate."""


def accuracy(durations: tuple[float, ...], seeds: range) -> Iterator[dict[str, Any]]:
    """Errors of consistent bodies beside those of plain estimates, on the PUMA of table6."""
    for seconds in durations:
        errors: Errors = {}
        for seed in seeds:
            overrides = [f"motion.duration={seconds}", f"seed={seed}"]
            experiment = tb.Experiment.from_toml(ROOT / "experiments/table6.toml", overrides)
            tree, recording = tb.load_tree(experiment.model), tb.record(experiment)
            settings = experiment.identification
            made = [tb.identify(tree, recording, m, settings=settings) for m in SIGNALS]
            for used in (made[:1], made[1:], made):
                _add(errors, tree, used, _wrong_prior(tree, seed))
        yield {"what": "table6", "seconds": seconds, **_ratios(errors)}


def poor(seeds: range, speed: float) -> dict[str, Any]:
    """The same where a PUMA moves slowly, 5 s: at a part of a usual speed."""
    tree, errors = tb.load_tree(ROOT / "models/puma562.xml"), Errors()
    for seed in seeds:
        recording = measured(tree, seed, duration=5.0, speed=speed)
        for method in SIGNALS:
            try:
                estimate = tb.identify(tree, recording, method)
            except UnidentifiableParameters:
                continue
            _add(errors, tree, [estimate], _wrong_prior(tree, seed))
    return {"what": "PUMA, 5 s", "speed": speed, **_ratios(errors)}


def _wrong_prior(tree: tb.Tree, seed: int) -> PriorBodies:
    return prior_of(perturbed_robot(tree, PRIOR, np.random.default_rng([seed, 17])))


def _add(errors: Errors, tree: tb.Tree, used: Sequence[Estimate], prior: PriorBodies) -> None:
    for estimate, own in zip(used, consistent(tree, used, prior).bent, strict=True):
        pair = _error(tree, estimate, estimate.values), _error(tree, estimate, own.values)
        errors.setdefault(f"{estimate.method} of {len(used)}", []).append(pair)


def _error(tree: tb.Tree, estimate: Estimate, values: Array) -> float:
    """Rms relative error of minimal parameters."""
    minimal = estimate.minimal
    truth = minimal.values(tb.barycentric(tree))
    error = finite_rms(relative_errors(values[: len(truth)], truth, minimal.units))
    assert error is not None
    return float(error)


def _ratios(errors: Errors) -> dict[str, list[float]]:
    """How many, median and most of consistent over plain errors."""
    found = {}
    for key, pairs in errors.items():
        plain, own = np.array(pairs).T
        most = float(np.max(own / plain))
        found[key] = [len(pairs), round(float(np.median(own / plain)), 3), round(most, 3)]
    return found


def trees(count: int, first: int = 0) -> dict[str, Any]:
    """Random trees of 3 to 12 joints: whether they are solved, and the thinnest body."""
    solved, made, least = 0, 0, np.inf
    for seed in range(first, first + count):
        rng = np.random.default_rng(seed)
        tree = random_robot(rng, int(rng.integers(3, 13))).tree()
        recording = measured(tree, seed, duration=10.0)
        try:
            estimates = [tb.identify(tree, recording, method) for method in SIGNALS]
        except tb.TestbedError:
            continue
        made += 1
        found = consistent(tree, estimates, prior_of(perturbed_robot(tree, PRIOR, rng)))
        solved += bool(found.unsettled < 1e-3 and (found.eigenvalues[:, 0] > 0).all())
        least = min(least, float((found.eigenvalues[:, 0] / found.eigenvalues[:, -1]).min()))
    return {
        "count": count,
        "solved": solved,
        "identified": made,
        "least eigenvalue ratio": float(f"{least:.2g}"),
    }


def main(
    seeds: Annotated[int, typer.Option(help="Simulated recordings of each length.")] = 10,
    count: Annotated[int, typer.Option("--trees", help="Random trees.")] = 100,
) -> None:
    """Consistent bodies: accuracy beside plain estimates."""
    drawn = range(500, 500 + seeds)
    print_lines([trees(count, 1000)])
    print_lines(poor(drawn, speed) for speed in (0.3, 0.1))
    print_lines(accuracy((60.0, 5.0), drawn))
