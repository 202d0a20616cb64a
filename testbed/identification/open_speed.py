"""The speed at which friction fades out, where the terms leave it open: an outer loop.

The internal fit is linear for any speed. Columns of many speeds are made in one pass; each fit has
those of one, and the best is looked for more closely in a second pass.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.arrays import Array
from testbed.blas import one_blas_thread
from testbed.dynamics.drive_set import drive_set
from testbed.errors import round_significant
from testbed.identification.noise.scaled import scaled_solve
from testbed.identification.normal_equations import NormalEquations, gather
from testbed.identification.passes import Passes, Progress
from testbed.identification.settings import Settings
from testbed.identification.weights import noise_weights
from testbed.identification.windows import make_plan
from testbed.kernel.layout import layout
from testbed.kernel.records import products_wanted
from testbed.parameters.joint_terms import DriveSet
from testbed.parameters.minimal_set import MinimalSet
from testbed.recordings.source import Source
from testbed.robot.friction import STRIBECK, stribeck
from testbed.robot.tree import Tree

SPEEDS = tuple(np.geomspace(0.01, 1.0, 13).tolist())
"""First look [rad/s or m/s]."""

CLOSER = 9
"""Speeds of the second look, between the neighbours of the best."""


def with_speed(
    tree: Tree,
    source: Source,
    minimal: MinimalSet,
    settings: Settings,
    threads: int | None = None,
    progress: Progress = lambda done, total: None,
) -> Settings:
    """Settings whose terms say the speed at which friction fades out, one for all joints.

    Args:
        tree: The robot, under the recording's gravity.
        source: With joint torques.
        minimal: The dynamic set.
        settings: With "stribeck" among the terms.
        threads: How many to use.
        progress: Called with samples done and samples in all.
    """

    def best(speeds: tuple[float, ...]) -> int:
        laws = (*settings.words, *(stribeck(speed) for speed in speeds))
        drives = drive_set(tree, minimal, laws)
        rows = layout(tree.without_inertias(), minimal, drives.terms, False)
        passes = Passes(make_plan(source, rows, np.zeros(6), settings), threads, progress, 1)
        with one_blas_thread():
            sums = passes.sums(products_wanted(tree.n))
            equations = gather(rows, drives.names, tree.names, sums)
            costs = [_cost(_with_one(equations, drives, speed)) for speed in speeds]
        return int(np.argmin(costs))

    first = best(SPEEDS)
    low, high = SPEEDS[max(first - 1, 0)], SPEEDS[min(first + 1, len(SPEEDS) - 1)]
    closer = tuple(round_significant(speed, 3) for speed in np.geomspace(low, high, CLOSER))
    found = f"{STRIBECK}@{closer[best(closer)]:g}"
    asked = settings.terms or ()
    return replace(settings, terms=[found if term == STRIBECK else term for term in asked])


def _with_one(equations: NormalEquations, drives: DriveSet, speed: float) -> NormalEquations:
    """The equations with the columns of one speed alone."""
    ours, kind = stribeck(speed), f"{STRIBECK}@"
    kept = [*range(drives.minimal.count)]
    for k, term in enumerate(drives.terms, start=drives.minimal.count):
        if not term.law.kind.startswith(kind) or term.law == ours:
            kept.append(k)
    return equations.of_unknowns(kept)


def _cost(equations: NormalEquations) -> float:
    """What likelihood says of the best fit: the less the better."""
    weights: Array = noise_weights(equations, None, False)
    values = scaled_solve(equations.matrix(weights), equations.vector(weights))
    left = np.diagonal(equations.residual(values)) / np.maximum(equations.used, 1.0)
    tiny = np.finfo(float).tiny
    return float(equations.used @ np.log(np.maximum(left, tiny)))
