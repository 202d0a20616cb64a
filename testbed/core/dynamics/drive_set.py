"""Bodies, joints and shafts together: which terms of the torques have columns of their own.

What joints add is grouped exactly (`parameters.joint_terms`). A shaft that turns with several
joints adds to the torques of all of them at once; whether that is a sum of what is there already is
a matter of the geometry, too, and found at random states: an inertia of two joints with parallel
axes may be a body's, the friction of a differential's two shafts may be that of its joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array, readonly
from testbed.core.dynamics.newton_euler import Motion, parameter_regressor, regressor
from testbed.core.parameters.joint_terms import DriveSet, with_joint_terms
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.regroup import Space, distance, recursive_space, row_space
from testbed.core.parameters.rules import Model
from testbed.core.robot.friction import JointLaw, JointTerm, joint_terms, term_torque
from testbed.core.robot.tree import Tree

ZERO = 1e-10
"""Singular values of a sampled regressor below this share of the largest count as zero."""

CLEAR_GAP = 1e3
"""Least gap between singular values kept and dropped for the sampled rank to be trusted."""

SAME = 1e-7
"""Sine of the angle between two row spaces below which they are the same."""

UNCHANGED = 1e-8
"""Largest relative change of the model by regrouping; files with rounded angles come near it."""

INVERSE = 1e-9
"""Largest element of S lift - 1 that is rounding."""


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
        exact = self.change <= UNCHANGED and self.inverse <= INVERSE
        return same and near and exact and self.gap >= CLEAR_GAP


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
    rows = parameter_regressor(tree, random_states(tree, seed), model, gravity)
    return (rows - rows[:1] if tared else rows).reshape(-1, 10 * tree.n)


def random_states(tree: Tree, seed: int = 0) -> Motion:
    """Enough random states of a robot to identify all that can be; the first is rest at q = 0."""
    rng = np.random.default_rng(seed)
    samples = 25 + 4 * tree.n
    span = np.where([joint.revolute for joint in tree.joints], np.pi, 1.0)
    q = rng.uniform(-1, 1, (samples, tree.n)) * span
    qd, qdd = rng.uniform(-3, 3, (2, samples, tree.n))
    q[0] = qd[0] = qdd[0] = 0.0
    return Motion(np.arange(samples, dtype=float), q, qd, qdd)


def verify(tree: Tree, minimal: MinimalSet) -> Agreement:
    """Compare a minimal set by the rules with two numerical witnesses.

    Parameters known to be zero are so for all three.

    Args:
        tree: The robot.
        minimal: Its set.
    """
    model, g, tared, zero = minimal.model, minimal.gravity, minimal.tared, minimal.known_zero
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


DEPENDENT = 1e-8
"""Part of a term's column beyond all others below which it depends on them."""

NOTHING = 1e-9
"""Coefficients of a sum, beside its largest, that are rounding."""

SEED = 20_000
"""Of the states; witnesses take others."""


def drive_set(tree: Tree, minimal: MinimalSet, laws: Sequence[str | JointLaw]) -> DriveSet:
    """The minimal set of bodies, joints and shafts together, before any data.

    Args:
        tree: The robot; only its geometry and its shafts matter.
        minimal: Its dynamic set.
        laws: Of the torques of joints and shafts: "rotor" holds at all of them, "rotor/elbow"
            at that one.

    Raises:
        UnknownName: There is no such law, joint or shaft.
    """
    found = with_joint_terms(tree, minimal, laws)
    more = [term for term in joint_terms(tree, laws) if term.joint >= tree.n]
    if not more:
        return found
    states = random_states(tree, SEED)

    def column(term: JointTerm) -> Array:
        return term_torque(tree, term, states.qd, states.qdd, states.t).ravel()

    rows = regressor(tree, states, minimal).reshape(-1, minimal.count)
    every = np.column_stack([rows, *(column(term) for term in found.terms)])
    own, made = list(found.terms), [found.columns]
    for term in more:
        sums, beyond = _as_a_sum(every, column(term))
        if beyond > DEPENDENT:
            every = np.column_stack([every, column(term)])
            own.append(term)
            sums = np.eye(1, every.shape[1], every.shape[1] - 1)[0]
        made.append(sums[:, None])
    columns = np.zeros((every.shape[1], len(found.asked) + len(more)))
    at = 0
    for part in made:
        columns[: len(part), at : at + part.shape[1]] = part
        at += part.shape[1]
    fixed = readonly(columns, columns.shape, "columns")
    return DriveSet(minimal, (*found.asked, *more), tuple(own), fixed, tree)


def _as_a_sum(every: Array, column: Array) -> tuple[Array, float]:
    """Coefficients of a column on others, and the part of it that is beyond them."""
    size = np.linalg.norm(every, axis=0)
    size = np.where(size > 0, size, 1.0)
    found = np.linalg.lstsq(every / size, column, rcond=1e-12)[0] / size
    found = np.where(np.abs(found) > NOTHING * np.abs(found).max(initial=0.0), found, 0.0)
    left = np.linalg.norm(column - every @ found) / np.linalg.norm(column)
    return np.round(found, 12), float(left)
