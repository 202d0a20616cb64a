"""Bodies, joints and shafts together: which terms of the torques have columns of their own.

What joints add is grouped exactly (`parameters.joint_terms`). A shaft that turns with several
joints adds to the torques of all of them at once; whether that is a sum of what is there already is
a matter of the geometry, too, and found at random states: an inertia of two joints with parallel
axes may be a body's, the friction of a differential's two shafts may be that of its joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array, readonly
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.dynamics.regressor import regressor
from testbed.core.parameters.joint_terms import DriveSet, with_joint_terms
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.robot.friction import JointTerm, joint_terms, term_torque
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.tree import Tree


def random_states(tree: Tree, seed: int = 0) -> Motion:
    """Enough random states of a robot to identify all that can be; the first is rest at q = 0."""
    rng = np.random.default_rng(seed)
    samples = 25 + 4 * tree.n
    span = np.where([joint.revolute for joint in tree.joints], np.pi, 1.0)
    q = rng.uniform(-1, 1, (samples, tree.n)) * span
    qd, qdd = rng.uniform(-3, 3, (2, samples, tree.n))
    q[0] = qd[0] = qdd[0] = 0.0
    return Motion(np.arange(samples, dtype=float), q, qd, qdd)


def drive_set(
    tree: Tree, minimal: MinimalSet, laws: Sequence[str | JointLaw]
) -> DriveSet:
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
    # of the states; witnesses take others
    states = random_states(tree, 20_000)

    def column(term: JointTerm) -> Array:
        return term_torque(tree, term, states.qd, states.qdd, states.t).ravel()

    rows = regressor(tree, states, minimal).reshape(-1, minimal.count)
    every = np.column_stack([rows, *(column(term) for term in found.terms)])
    own, made = list(found.terms), [found.columns]
    for term in more:
        sums, beyond = _as_a_sum(every, column(term))
        # part of a term's column beyond all others below which it depends on them
        if beyond > 1e-8:
            every = np.column_stack([every, column(term)])
            own.append(term)
            sums = np.eye(1, every.shape[1], every.shape[1] - 1)[0]
        made.append(sums[:, None])
    padded = (np.pad(part, ((0, every.shape[1] - len(part)), (0, 0))) for part in made)
    columns = np.hstack([*padded])
    fixed = readonly(columns, columns.shape, "columns")
    return DriveSet(minimal, (*found.asked, *more), tuple(own), fixed, tree)


def _as_a_sum(every: Array, column: Array) -> tuple[Array, float]:
    """Coefficients of a column on others, and the part of it that is beyond them."""
    size = np.linalg.norm(every, axis=0)
    size = np.where(size > 0, size, 1.0)
    found = np.linalg.lstsq(every / size, column, rcond=1e-12)[0] / size
    # coefficients of a sum, beside its largest, that are rounding
    found = np.where(np.abs(found) > 1e-9 * np.abs(found).max(initial=0.0), found, 0.0)
    left = np.linalg.norm(column - every @ found) / np.linalg.norm(column)
    return np.round(found, 12), float(left)
