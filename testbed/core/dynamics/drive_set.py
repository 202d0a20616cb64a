"""Minimal set of bodies, joints and drive shafts, with redundant terms eliminated.

Terms of single joints are regrouped exactly (`parameters.joint_terms`). A shaft that turns with
several joints adds to the torques of all these joints. Linear dependence of its regressor column on
the other columns is tested by least squares at random states. For example, the inertia of a shaft
that drives two joints with parallel axes can be indistinguishable from the inertia of a body, and
the friction of the two shafts of a differential from the friction of its joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array, readonly_array
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.dynamics.regressor import regressor
from testbed.core.parameters.joint_terms import DriveSet, with_joint_terms
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.robot.friction import JointTerm, joint_terms, term_torque
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.tree import Tree


def random_states(tree: Tree, seed: int = 0) -> Motion:
    """Random joint states, enough to identify all identifiable parameters.

    The 25 + 4 n states are uniformly distributed: positions between -pi and pi rad (or -1 and 1 m),
    velocities and accelerations between -3 and 3. The first state is at rest at q = 0.

    Args:
        tree: The robot.
        seed: Seed of the random numbers.
    """
    rng = np.random.default_rng(seed)
    samples = 25 + 4 * tree.n
    span = np.where([joint.revolute for joint in tree.joints], np.pi, 1.0)
    q = rng.uniform(-1, 1, (samples, tree.n)) * span
    qd, qdd = rng.uniform(-3, 3, (2, samples, tree.n))
    q[0] = qd[0] = qdd[0] = 0.0
    return Motion(np.arange(samples, dtype=float), q, qd, qdd)


def make_drive_set(
    tree: Tree, minimal: MinimalSet, laws: Sequence[str | JointLaw]
) -> DriveSet:
    """Minimal set of the parameters of bodies, joints and shafts, from geometry alone.

    A term of a shaft becomes an unknown unless its torques at random states are a linear
    combination of the torques of earlier unknowns.

    Args:
        tree: The robot; only its geometry and its shafts matter.
        minimal: Minimal set of the bodies for joint torques.
        laws: Torque laws of joints and shafts: "rotor" for all, "rotor/elbow" for one of them.

    Raises:
        UnknownName: There is no such law, joint or shaft.
    """
    joint_set = with_joint_terms(tree, minimal, laws)
    shaft_terms = [term for term in joint_terms(tree, laws) if term.joint >= tree.n]
    if not shaft_terms:
        return joint_set
    # seed of the states; checks use others
    states = random_states(tree, 20_000)

    def column(term: JointTerm) -> Array:
        return term_torque(tree, term, states.qd, states.qdd, states.t).ravel()

    rows = regressor(tree, states, minimal).reshape(-1, minimal.count)
    regressor_columns = np.column_stack(
        [rows, *(column(term) for term in joint_set.terms)]
    )
    independent_terms, blocks = list(joint_set.terms), [joint_set.columns]
    for term in shaft_terms:
        coefficients, residual = _linear_combination(regressor_columns, column(term))
        # relative residual above which a term's column is independent of the others
        if residual > 1e-8:
            regressor_columns = np.column_stack([regressor_columns, column(term)])
            independent_terms.append(term)
            coefficients = np.eye(
                1, regressor_columns.shape[1], regressor_columns.shape[1] - 1
            )[0]
        blocks.append(coefficients[:, None])
    padded = (
        np.pad(block, ((0, regressor_columns.shape[1] - len(block)), (0, 0)))
        for block in blocks
    )
    columns = np.hstack([*padded])
    matrix = readonly_array(columns, columns.shape, "columns")
    return DriveSet(
        minimal,
        (*joint_set.asked, *shaft_terms),
        tuple(independent_terms),
        matrix,
        tree,
    )


def _linear_combination(columns: Array, column: Array) -> tuple[Array, float]:
    """Least-squares coefficients of a column on other columns, and the relative residual.

    Args:
        columns: The other columns, (k, p).
        column: The column, (k,).
    """
    scale = np.linalg.norm(columns, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    coefficients = np.linalg.lstsq(columns / scale, column, rcond=1e-12)[0] / scale
    # coefficients that are rounding, relative to the largest
    coefficients = np.where(
        np.abs(coefficients) > 1e-9 * np.abs(coefficients).max(initial=0.0),
        coefficients,
        0.0,
    )
    residual = np.linalg.norm(column - columns @ coefficients) / np.linalg.norm(column)
    return np.round(coefficients, 12), float(residual)
