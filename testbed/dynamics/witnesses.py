"""Witnesses of a minimal set: the rank of a sampled regressor, and all three together.

The rules, the recursion and the sampled regressor share no code but the tree; they are
compared as row spaces, not as counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import parameter_regressor
from testbed.dynamics.motion import Motion
from testbed.parameters.exact_recursion import recursive_space
from testbed.parameters.minimal_set import MinimalSet
from testbed.parameters.row_space import Space, distance, row_space
from testbed.parameters.rules import Model
from testbed.robot.tree import Tree

ZERO = 1e-10
"""Singular values of a sampled regressor below this share of the largest count as zero."""

CLEAR_GAP = 1e3
"""Least gap between singular values kept and dropped for the sampled rank to be trusted."""

SAME = 1e-7
"""Sine of the angle between two row spaces below which they are the same."""


@dataclass(frozen=True)
class Agreement:
    """Three answers to one question.

    Attributes:
        model: "dynamic" or "reaction".
        rules: Count by the rules of Tables 2-5.
        recursion: Count by the exact recursion.
        sampled: Rank of a sampled regressor.
        recursion_distance: Sine of the largest angle between rules and recursion.
        sampled_distance: Likewise between rules and sampled regressor.
        gap: Between singular values kept and dropped of the sampled regressor.
        change: Largest relative change of the model when eliminated parameters are set to
            zero and redefined ones used.
    """

    model: Model
    rules: int
    recursion: int
    sampled: int
    recursion_distance: float
    sampled_distance: float
    gap: float
    change: float

    @property
    def holds(self) -> bool:
        """Whether all three agree, and the sampled rank was a clear decision."""
        same = max(self.recursion_distance, self.sampled_distance) <= SAME
        return same and self.gap >= CLEAR_GAP


def sampled_regressor(
    tree: Tree,
    model: Model,
    gravity: ArrayLike | None = None,
    *,
    tared: bool = False,
    seed: int = 0,
) -> Array:
    """Regressor rows on the barycentric parameters at random states, (rows, 10 n).

    Args:
        tree: The robot; only its geometry matters.
        model: "dynamic" for joint torques, "reaction" for the bedplate's wrench.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
        tared: Take off the rows of the robot at rest at q = 0.
        seed: Of the states.
    """
    rng = np.random.default_rng(seed)
    samples = 25 + 4 * tree.n
    span = np.where([joint.revolute for joint in tree.joints], np.pi, 1.0)
    q = rng.uniform(-1, 1, (samples, tree.n)) * span
    qd, qdd = rng.uniform(-3, 3, (2, samples, tree.n))
    q[0] = qd[0] = qdd[0] = 0.0
    motion = Motion(np.arange(samples, dtype=float), q, qd, qdd)
    rows = parameter_regressor(tree, motion, model, gravity)
    return (rows - rows[:1] if tared else rows).reshape(-1, 10 * tree.n)


def verify(tree: Tree, minimal: MinimalSet, seed: int = 0) -> Agreement:
    """Hold a minimal set by the rules against both witnesses.

    Args:
        tree: The robot.
        minimal: Its set without known zeros.
        seed: Of the sampled states.
    """
    rows = sampled_regressor(tree, minimal.model, minimal.gravity, tared=minimal.tared, seed=seed)
    sampled = row_space(rows, ZERO)
    recursion = recursive_space(tree, minimal.model, minimal.gravity, tared=minimal.tared)
    rules = Space(np.linalg.qr(minimal.matrix.T)[0].T, np.inf)
    regrouped = (rows @ minimal.lift) @ minimal.matrix
    return Agreement(
        model=minimal.model,
        rules=minimal.count,
        recursion=recursion.rank,
        sampled=sampled.rank,
        recursion_distance=distance(rules, recursion),
        sampled_distance=distance(rules, sampled),
        gap=sampled.gap,
        change=float(np.abs(regrouped - rows).max() / np.abs(rows).max()),
    )
