"""Derivatives by a motion from differences, which share no code with slopes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import testbed as tb
from testbed.arrays import Array
from testbed.excitation.sampled_rows import SampledRows
from testbed.excitation.samples import Samples
from testbed.excitation.stencil import stencil
from testbed.parameters.rules import Model

STEP = 0.02


def samples_of(tree: tb.Tree, motion: tb.Motion) -> Samples:
    """A motion's states with the rows of both models."""
    models: tuple[Model, ...] = ("reaction", "dynamic")
    rows = {model: SampledRows(tree, tb.minimal_set(tree, model)) for model in models}
    return Samples(motion.q, motion.qd, motion.qdd, rows, stencil(tree))


def slopes_by_differences(motion: tb.Motion, values: Callable[[tb.Motion], Array]) -> Array:
    """Differences of sixth order of values, (k, M), by q, qd and qdd, (k, 3 n, M)."""
    columns = []
    for kind in range(3):
        for j in range(motion.q.shape[1]):
            total: Array = np.zeros(1)
            for k, weight in ((1, 45.0), (2, -9.0), (3, 1.0)):
                for sign in (1, -1):
                    parts = [motion.q.copy(), motion.qd.copy(), motion.qdd.copy()]
                    parts[kind][:, j] += sign * k * STEP
                    moved = values(tb.Motion(motion.t, *parts))
                    total = total + sign * weight * moved / (60 * STEP)
            columns.append(total)
    return np.stack(columns, axis=1)
