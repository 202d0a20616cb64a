"""Minimal sets held against two witnesses: the exact recursion, and sampled regressors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.core.base.arrays import Array, skew
from testbed.core.dynamics.drive_set import random_states
from testbed.core.dynamics.newton_euler import parameter_regressor
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.regroup import (
    NEW,
    base_functionals,
    moved_inertia,
    seen_wrenches,
    span,
)
from testbed.core.parameters.rules import Model
from testbed.core.parameters.symbols import STANDARD_ORDER, to_standard
from testbed.core.robot.friction import term_torque
from testbed.core.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class Space:
    """A row space of functionals on the 10 n barycentric parameters.

    Attributes:
        rows: (rank, 10 n), orthonormal.
        gap: Ratio of the smallest singular value kept to the largest one dropped: how
            clear the decision on the rank was.
    """

    rows: Array
    gap: float

    @property
    def rank(self) -> int:
        """Number of functionals."""
        return len(self.rows)


def row_space(
    rows: Array, tolerance: float, known_zero: NDArray[np.bool_] | None = None
) -> Space:
    """The space spanned by rows, (k, 10 n).

    Args:
        rows: Of any sizes; rows are not rescaled, so rounding of zero stays small.
        tolerance: Singular values below this share of the largest count as zero.
        known_zero: Parameters known to be zero, (n, 10), whose columns do not count;
            default none.
    """
    # part of all rows that is rounding of zero, whatever is left of them
    rounding = 1e-13 * float(np.linalg.norm(rows))
    if known_zero is not None:
        rows = np.where(known_zero.ravel(), 0.0, rows)
    if not rows.any():
        return Space(np.zeros((0, rows.shape[1])), np.inf)
    _, spread, directions = np.linalg.svd(rows, full_matrices=False)
    rank = int(np.sum(spread > max(tolerance * spread[0], rounding)))
    if rank == 0:
        return Space(directions[:0], np.inf)
    dropped = spread[rank] if rank < len(spread) else 0.0
    return Space(directions[:rank], float(spread[rank - 1] / max(dropped, 1e-300)))


def distance(a: Space, b: Space) -> float:
    """Sine of the largest angle between two row spaces of one rank; 1 if the ranks differ."""
    if a.rank != b.rank:
        return 1.0
    if a.rank == 0:
        return 0.0
    return float(np.linalg.norm(a.rows - (a.rows @ b.rows.T) @ b.rows, 2))


def recursive_space(
    tree: Tree,
    model: Model,
    gravity: ArrayLike | None = None,
    *,
    tared: bool = False,
    known_zero: NDArray[np.bool_] | None = None,
) -> Space:
    """What a measurement can identify, by the exact recursion.

    Args:
        tree: The robot; only its geometry matters.
        model: "dynamic" for joint torques, "reaction" for the bedplate's wrench.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
        tared: The bedplate's static wrench in one posture has been taken off.
        known_zero: Barycentric parameters known to be zero, (n, 10); default none.
    """
    g = tree.gravity_or(gravity)
    if tree.sensor is not None:
        static = base_functionals(tree, g, tared=tared)
    else:
        static = _static(g) if model == "reaction" and not tared else np.zeros((0, 10))
    seen = [each.whole for each in seen_wrenches(tree, model, g, static)]
    if tree.sensor is not None:  # what leads to the base has no matter
        seen[: tree.lead] = [np.zeros((0, 10))] * tree.lead
        rows = _on_barycentric(tree, seen, static, tree.sensor_body)
        return row_space(rows, NEW, known_zero)
    return row_space(_on_barycentric(tree, seen, static), NEW, known_zero)


def _on_barycentric(
    tree: Tree, seen: list[Array], static: Array, base: int = -1
) -> Array:
    """Functionals of composites as functionals of the barycentric parameters, (k, 10 n)."""
    n = tree.n
    composite = np.zeros((n + 1, 10, 10 * n))  # at q = 0; the last is the bedplate's
    to_ours = _standard_from_barycentric(tree)
    rows: list[Array] = []
    for j in reversed(range(n)):
        composite[j] += to_ours[10 * j : 10 * j + 10]
        composite[tree.parents[j]] += moved_inertia(tree.joints[j].X_PB) @ composite[j]
        rows.insert(0, seen[j] @ composite[j])
    rows.append(static @ composite[base])
    return np.vstack(rows)


def _standard_from_barycentric(tree: Tree) -> Array:
    """(m, h, I) of every body, I in the order xx xy xz yy yz zz, from theta, (10 n, 10 n)."""
    theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
    return to_standard(tree, theta)[:, STANDARD_ORDER].reshape(10 * tree.n, -1)


def _static(gravity: Array) -> Array:
    """The static wrench's functionals: mass, and two first moments normal to gravity."""
    if not gravity.any():
        return np.zeros((0, 10))
    rows = np.zeros((4, 10))
    rows[0, 0] = 1.0
    rows[1:, 1:4] = skew(gravity / np.linalg.norm(gravity))
    return span(rows)


ZERO = 1e-10
"""Singular values of a sampled regressor below this share of the largest count as zero."""


CLEAR_GAP = 1e3
"""Least gap between singular values kept and dropped for the sampled rank to be trusted."""


SAME = 1e-7
"""Sine of the angle between two row spaces below which they are the same."""


UNCHANGED = 1e-8
"""Largest relative change of the model by regrouping; files with rounded angles come near it."""


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
        inverse: Largest element of S lift - 1.
    """

    model: Model
    rules: int
    recursion: int
    sampled: int
    recursion_distance: float
    sampled_distance: float
    gap: float
    change: float
    inverse: float

    @property
    def holds(self) -> bool:
        """Whether all three agree, and the sampled rank was a clear decision.

        Sampling knows its space only as well as it separates it from rounding, to 1 / gap; that
        regrouping does not change the model holds more exactly.
        """
        same = self.recursion_distance <= SAME
        near = self.sampled_distance <= max(SAME, 1.0 / self.gap)
        # largest element of S lift - 1 that is rounding
        exact = self.change <= UNCHANGED and self.inverse <= 1e-9
        return same and near and exact and self.gap >= CLEAR_GAP


def sampled_regressor(
    tree: Tree,
    model: Model,
    gravity: ArrayLike | None = None,
    *,
    tared: bool = False,
) -> Array:
    """Regressor rows on the barycentric parameters at random states, (rows, 10 n).

    Args:
        tree: The robot; only its geometry matters.
        model: "dynamic" for joint torques, "reaction" for the bedplate's wrench.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
        tared: Take off the rows of the robot at rest at q = 0.
    """
    rows = parameter_regressor(tree, random_states(tree), model, gravity)
    return (rows - rows[:1] if tared else rows).reshape(-1, 10 * tree.n)


def verify(tree: Tree, minimal: MinimalSet) -> Agreement:
    """Verify a minimal set against the exact recursion and the rank of a sampled regressor.

    Parameters known to be zero are so for all three.

    Args:
        tree: The robot.
        minimal: Its set.
    """
    model, g, tared, zero = (
        minimal.model,
        minimal.gravity,
        minimal.tared,
        minimal.known_zero,
    )
    rows = sampled_regressor(tree, model, g, tared=tared)
    sampled = row_space(rows, ZERO, zero)
    size = np.abs(rows).max(initial=1e-300)
    rows[:, zero.ravel()] = 0.0
    recursion = recursive_space(tree, model, g, tared=tared, known_zero=zero)
    rules = Space(np.linalg.qr(minimal.matrix.T)[0].T, np.inf)
    regrouped = (rows @ minimal.lift) @ minimal.matrix
    inverse = minimal.matrix @ minimal.lift - np.eye(minimal.count)
    return Agreement(
        model=minimal.model,
        rules=minimal.count,
        recursion=recursion.rank,
        sampled=sampled.rank,
        recursion_distance=distance(rules, recursion),
        sampled_distance=distance(rules, sampled),
        gap=sampled.gap,
        change=float(np.abs(regrouped - rows).max(initial=0.0) / size),
        inverse=float(np.abs(inverse).max(initial=0.0)),
    )


@dataclass(frozen=True)
class DriveAgreement:
    """Bodies and drives together, by structure and by sampling.

    Attributes:
        count: Unknowns, by the exact recursion.
        sampled: Rank of the sampled regressor and the terms' columns together.
        gap: Between singular values kept and dropped.
        change: Largest relative difference between those columns and what the unknowns'
            own columns give.
    """

    count: int
    sampled: int
    gap: float
    change: float

    @property
    def holds(self) -> bool:
        """Whether both agree, and the sampled rank was a clear decision."""
        same = self.count == self.sampled and self.gap >= CLEAR_GAP
        return same and self.change <= UNCHANGED


def verify_drives(tree: Tree, drives: DriveSet) -> DriveAgreement:
    """Hold a minimal set of bodies and drives together against sampled columns.

    Args:
        tree: The robot.
        drives: Its set.
    """
    minimal, states = drives.minimal, random_states(tree)
    rows = sampled_regressor(tree, "dynamic", minimal.gravity)
    rows[:, minimal.known_zero.ravel()] = 0.0
    torques = np.zeros((len(states.qd), tree.n, len(drives.asked)))
    for k, term in enumerate(drives.asked):
        torques[:, :, k] = term_torque(tree, term, states.qd, states.qdd)
    terms = torques.reshape(len(rows), len(drives.asked))
    every = np.hstack([rows, terms])
    space = row_space(every, ZERO)
    own = [drives.asked.index(term) for term in drives.terms]
    ours = np.hstack([rows @ minimal.lift, terms[:, own]])
    change = np.abs(ours @ drives.matrix - every).max() / np.abs(every).max()
    return DriveAgreement(drives.count, space.rank, space.gap, float(change))
