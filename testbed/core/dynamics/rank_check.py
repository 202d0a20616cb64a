"""Checks of minimal sets against an exact recursion and the rank of sampled regressors."""

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
    INDEPENDENCE_TOLERANCE,
    base_functionals,
    composite_functionals,
    inertia_transform,
    row_space_basis,
)
from testbed.core.parameters.rules import Signal
from testbed.core.parameters.symbols import (
    STANDARD_PERMUTATION,
    standard_from_barycentric,
)
from testbed.core.robot.friction import term_torque
from testbed.core.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class RowSpace:
    """Row space of functionals on the 10 n barycentric parameters.

    Attributes:
        rows: Orthonormal basis, (rank, 10 n).
        gap: Ratio of the smallest retained to the largest dropped singular value; a large ratio
            means a clear numerical rank.
    """

    rows: Array
    gap: float

    @property
    def rank(self) -> int:
        """Dimension of the row space."""
        return len(self.rows)


def row_space(
    rows: Array, tolerance: float, known_zero: NDArray[np.bool_] | None = None
) -> RowSpace:
    """Row space of a matrix by singular value decomposition.

    Args:
        rows: Matrix, (k, 10 n); its rows are not rescaled, so that rounding errors of zero rows
            stay small.
        tolerance: Relative size below which singular values are treated as zero.
        known_zero: Mask of parameters known to be zero, (n, 10), whose columns are set to zero;
            default none.
    """
    # rounding of zero, relative to all rows before columns are set to zero
    rounding = 1e-13 * float(np.linalg.norm(rows))
    if known_zero is not None:
        rows = np.where(known_zero.ravel(), 0.0, rows)
    if not rows.any():
        return RowSpace(np.zeros((0, rows.shape[1])), np.inf)
    _, singular_values, directions = np.linalg.svd(rows, full_matrices=False)
    rank = int(np.sum(singular_values > max(tolerance * singular_values[0], rounding)))
    if rank == 0:
        return RowSpace(directions[:0], np.inf)
    dropped = singular_values[rank] if rank < len(singular_values) else 0.0
    return RowSpace(
        directions[:rank], float(singular_values[rank - 1] / max(dropped, 1e-300))
    )


def row_space_distance(a: RowSpace, b: RowSpace) -> float:
    """Sine of the largest angle between two row spaces; 1 for different ranks."""
    if a.rank != b.rank:
        return 1.0
    if a.rank == 0:
        return 0.0
    return float(np.linalg.norm(a.rows - (a.rows @ b.rows.T) @ b.rows, 2))


def recursion_row_space(
    tree: Tree,
    model: Signal,
    gravity: ArrayLike | None = None,
    *,
    tared: bool = False,
    known_zero: NDArray[np.bool_] | None = None,
) -> RowSpace:
    """Row space of the identifiable parameter combinations, computed by the exact recursion.

    Args:
        tree: The robot; only its geometry matters.
        model: "torque" for joint torques, "wrench" for the bedplate's wrench.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2]; default the model file's.
        tared: True if the bedplate's static wrench in one posture has been subtracted.
        known_zero: Mask of barycentric parameters known to be zero, (n, 10); default none.
    """
    g = tree.gravity_or(gravity)
    if tree.sensor is not None:
        static = base_functionals(tree, g, is_tared=tared)
    else:
        static = (
            _static_functionals(g)
            if model == "wrench" and not tared
            else np.zeros((0, 10))
        )
    functionals = [each.basis for each in composite_functionals(tree, model, g, static)]
    if tree.sensor is not None:  # bodies that lead to the base are massless
        functionals[: tree.lead] = [np.zeros((0, 10))] * tree.lead
        rows = _barycentric_functionals(tree, functionals, static, tree.sensor_body)
        return row_space(rows, INDEPENDENCE_TOLERANCE, known_zero)
    return row_space(
        _barycentric_functionals(tree, functionals, static),
        INDEPENDENCE_TOLERANCE,
        known_zero,
    )


def _barycentric_functionals(
    tree: Tree, functionals: list[Array], static: Array, base: int = -1
) -> Array:
    """Convert functionals of composite bodies to functionals of barycentric parameters, (k, 10 n).

    Args:
        tree: The robot.
        functionals: Functionals of the ten parameters of each composite body, (k_j, 10).
        static: Functionals of the whole robot that the static wrench determines, (k, 10).
        base: Index of the body that carries the sensor; -1 for the bedplate.
    """
    n = tree.n
    composite = np.zeros((n + 1, 10, 10 * n))  # at q = 0; the last is for the bedplate
    to_standard_parameters = _standard_from_barycentric(tree)
    rows: list[Array] = []
    for j in reversed(range(n)):
        composite[j] += to_standard_parameters[10 * j : 10 * j + 10]
        composite[tree.parents[j]] += (
            inertia_transform(tree.joints[j].X_PB) @ composite[j]
        )
        rows.insert(0, functionals[j] @ composite[j])
    rows.append(static @ composite[base])
    return np.vstack(rows)


def _standard_from_barycentric(tree: Tree) -> Array:
    """Matrix from barycentric to standard parameters of all bodies, (10 n, 10 n).

    Standard parameters are m, h, I of each body, I in the order xx xy xz yy yz zz.
    """
    theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
    return standard_from_barycentric(tree, theta)[:, STANDARD_PERMUTATION].reshape(
        10 * tree.n, -1
    )


def _static_functionals(gravity: Array) -> Array:
    """Functionals determined by the static wrench of the bedplate, (3, 10) or (0, 10).

    They are the mass and the two first moments normal to gravity. Without gravity, the static
    wrench determines no functional.
    """
    if not gravity.any():
        return np.zeros((0, 10))
    rows = np.zeros((4, 10))
    rows[0, 0] = 1.0
    rows[1:, 1:4] = skew(gravity / np.linalg.norm(gravity))
    return row_space_basis(rows)


RANK_TOLERANCE = 1e-10
"""Relative size below which singular values of a sampled regressor are treated as zero."""


MIN_GAP = 1e3
"""Smallest ratio of retained to dropped singular values for a clear numerical rank."""


MAX_ANGLE_SINE = 1e-7
"""Largest sine of the angle between two row spaces that are considered equal."""


MAX_MODEL_CHANGE = 1e-8
"""Largest relative change of the model by regrouping, caused mostly by rounded angles in files."""


@dataclass(frozen=True)
class Agreement:
    """Comparison of a minimal set with the exact recursion and with sampled regressors.

    Attributes:
        model: "torque" or "wrench".
        rules: Number of parameters found by the rules of [FRS96] Tables 2-5.
        recursion: Number of parameters found by the exact recursion.
        sampled: Rank of a sampled regressor.
        recursion_distance: Sine of the largest angle between the row spaces of rules and recursion.
        sampled_distance: Sine of the largest angle between the row spaces of rules and sampled
            regressor.
        gap: Ratio of the smallest retained to the largest dropped singular value of the sampled
            regressor.
        change: Largest relative change of the model when eliminated parameters are set to zero and
            redefined parameters are used.
        inverse: Largest element of S lift - 1, where S is the matrix of the minimal set and `lift`
            its right inverse.
    """

    model: Signal
    rules: int
    recursion: int
    sampled: int
    recursion_distance: float
    sampled_distance: float
    gap: float
    change: float
    inverse: float

    @property
    def agrees(self) -> bool:
        """True if all row spaces agree, the sampled rank is clear and the model unchanged.

        The sampled row space is accurate only to 1 / gap; the change of the model due to regrouping
        is a stricter criterion.
        """
        recursion_agrees = self.recursion_distance <= MAX_ANGLE_SINE
        sampling_agrees = self.sampled_distance <= max(MAX_ANGLE_SINE, 1.0 / self.gap)
        # largest element of S lift - 1 that is rounding
        model_unchanged = self.change <= MAX_MODEL_CHANGE and self.inverse <= 1e-9
        return (
            recursion_agrees
            and sampling_agrees
            and model_unchanged
            and self.gap >= MIN_GAP
        )


def sampled_regressor(
    tree: Tree,
    model: Signal,
    gravity: ArrayLike | None = None,
    *,
    tared: bool = False,
) -> Array:
    """Regressor on the barycentric parameters at random states, (rows, 10 n).

    Args:
        tree: The robot; only its geometry matters.
        model: "torque" for joint torques, "wrench" for the bedplate's wrench.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2]; default the model file's.
        tared: True to subtract the regressor rows of the robot at rest at q = 0.
    """
    rows = parameter_regressor(tree, random_states(tree), model, gravity)
    return (rows - rows[:1] if tared else rows).reshape(-1, 10 * tree.n)


def verify_minimal_set(tree: Tree, minimal: MinimalSet) -> Agreement:
    """Compare a minimal set with the exact recursion and the rank of a sampled regressor.

    Parameters known to be zero are set to zero in all three.

    Args:
        tree: The robot.
        minimal: The minimal set.
    """
    model, g, tared, zero = (
        minimal.model,
        minimal.gravity,
        minimal.tared,
        minimal.known_zero,
    )
    rows = sampled_regressor(tree, model, g, tared=tared)
    sampled = row_space(rows, RANK_TOLERANCE, zero)
    size = np.abs(rows).max(initial=1e-300)
    rows[:, zero.ravel()] = 0.0
    recursion = recursion_row_space(tree, model, g, tared=tared, known_zero=zero)
    rules = RowSpace(np.linalg.qr(minimal.matrix.T)[0].T, np.inf)
    regrouped = (rows @ minimal.lift) @ minimal.matrix
    inverse = minimal.matrix @ minimal.lift - np.eye(minimal.count)
    return Agreement(
        model=minimal.model,
        rules=minimal.count,
        recursion=recursion.rank,
        sampled=sampled.rank,
        recursion_distance=row_space_distance(rules, recursion),
        sampled_distance=row_space_distance(rules, sampled),
        gap=sampled.gap,
        change=float(np.abs(regrouped - rows).max(initial=0.0) / size),
        inverse=float(np.abs(inverse).max(initial=0.0)),
    )


@dataclass(frozen=True)
class DriveAgreement:
    """Comparison of a minimal set of bodies and drives with sampled columns.

    Attributes:
        count: Number of unknowns found by `make_drive_set`.
        sampled: Rank of the sampled regressor together with the columns of the joint terms.
        gap: Ratio of the smallest retained to the largest dropped singular value.
        change: Largest relative difference between these columns and their reconstruction from the
            independent columns.
    """

    count: int
    sampled: int
    gap: float
    change: float

    @property
    def agrees(self) -> bool:
        """True if both counts agree, the sampled rank is clear and the model unchanged."""
        ranks_agree = self.count == self.sampled and self.gap >= MIN_GAP
        return ranks_agree and self.change <= MAX_MODEL_CHANGE


def verify_drive_set(tree: Tree, drives: DriveSet) -> DriveAgreement:
    """Compare a minimal set of bodies and drives with sampled columns.

    Args:
        tree: The robot.
        drives: Minimal set of bodies and drives.
    """
    minimal, states = drives.minimal, random_states(tree)
    rows = sampled_regressor(tree, "torque", minimal.gravity)
    rows[:, minimal.known_zero.ravel()] = 0.0
    torques = np.zeros((len(states.qd), tree.n, len(drives.asked)))
    for k, term in enumerate(drives.asked):
        torques[:, :, k] = term_torque(tree, term, states.qd, states.qdd)
    terms = torques.reshape(len(rows), len(drives.asked))
    all_columns = np.hstack([rows, terms])
    space = row_space(all_columns, RANK_TOLERANCE)
    independent = [drives.asked.index(term) for term in drives.terms]
    independent_columns = np.hstack([rows @ minimal.lift, terms[:, independent]])
    change = (
        np.abs(independent_columns @ drives.matrix - all_columns).max()
        / np.abs(all_columns).max()
    )
    return DriveAgreement(drives.count, space.rank, space.gap, float(change))
