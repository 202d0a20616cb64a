"""Rotations of gravity that are not identifiable from joint torques."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array, skew
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import vector_text
from testbed.core.dynamics.drive_set import random_states
from testbed.core.dynamics.newton_euler import Motion, linear_inverse_dynamics
from testbed.core.dynamics.regressor import regressor
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.robot.tree import Tree

DIFFERENCE_STEP = 1e-5
"""Step of joint positions for central differences [rad or m]."""

RELATIVE_TOLERANCE = 1e-6
"""Relative size below which an effect on the torques is rounding."""


def gravity_rotation_diagnostic(tree: Tree, minimal: MinimalSet) -> Diagnostic:
    """Diagnose small rotations of gravity that joint torques do not identify.

    The diagnostic lists the axes of these rotations, and the parameters or joint zeros that have
    the same effect on the torques. Effects are compared by orthogonal projection, for random bodies
    at random states.

    Args:
        tree: The robot; only its geometry matters.
        minimal: Minimal set for joint torques, with its gravity.
    """
    rotations, parameters, zeros = _effects(tree, minimal)
    candidates = {
        "changes nothing": parameters[:, :0],
        "as other parameters": parameters,
    }
    for name, zero in zip(tree.names, zeros.T, strict=True):
        candidates[f"as another zero of '{name}'"] = np.column_stack([parameters, zero])
    all_columns = candidates["as other zeros of joints"] = np.hstack(
        [parameters, zeros]
    )
    tolerance = RELATIVE_TOLERANCE * float(np.linalg.norm(rotations))
    phrases = []
    for axis in _null_axes(_projection_residuals(rotations, all_columns), tolerance):
        labels = (
            label
            for label, columns in candidates.items()
            if np.linalg.norm(_projection_residuals(rotations @ axis, columns))
            <= 2 * tolerance
        )
        phrases.append(f"{vector_text(np.round(axis, 6) + 0.0)} ({next(labels)})")
    return make_diagnostic("gravity.rotation", ", ".join(phrases))


def _null_axes(columns: Array, tolerance: float) -> Array:
    """Unit vectors that span the null space of three columns; coordinate axes if possible.

    Args:
        columns: The columns, (T, 3).
        tolerance: Largest singular value that is treated as zero.
    """
    from scipy.linalg import qr, svd

    _, singular_values, axes = svd(columns)
    null_vectors = axes[singular_values <= tolerance]
    projector = null_vectors.T @ null_vectors
    _, pivots = qr(np.round(projector, 9), mode="r", pivoting=True)
    rows: Array = projector[np.sort(pivots[: len(null_vectors)])]
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def _effects(tree: Tree, minimal: MinimalSet) -> tuple[Array, Array, Array]:
    """Derivatives of T torques with respect to rotations of gravity, parameters and joint zeros.

    The torques are those of random bodies at random states; for rotations of gravity, the bodies
    are at rest.

    Returns:
        Derivatives with respect to the three rotations, (T, 3), the N minimal parameters, (T, N),
        and the n joint zeros, (T, n).
    """
    states, gravity = random_states(tree), minimal.gravity
    bodies = np.random.default_rng(0).normal(size=(tree.n, 10, 1))
    bodies *= ~minimal.known_zero[..., None]

    def torques(motion: Motion, gravity: Array) -> Array:
        return linear_inverse_dynamics(tree, motion, bodies, gravity)[0].ravel()

    static = Motion.at_rest(states.q)
    rotations = np.stack([torques(static, each) for each in skew(gravity)], axis=1)
    torques_at_shifts = [
        torques(replace(states, q=states.q + shift), gravity)
        for shift in DIFFERENCE_STEP * np.vstack([np.eye(tree.n), -np.eye(tree.n)])
    ]
    zeros = np.subtract(*np.split(np.stack(torques_at_shifts, axis=1), 2, axis=1)) / (
        2 * DIFFERENCE_STEP
    )
    parameters = regressor(tree, states, minimal).reshape(len(zeros), -1)
    return rotations, parameters, zeros


def _projection_residuals(effects: Array, others: Array) -> Array:
    """Residuals of effects after projection onto the span of other columns.

    Args:
        effects: Effects on T torques, (T,) or (T, k).
        others: The other columns, (T, p).
    """
    from scipy.linalg import orth

    basis: Array = orth(others, RELATIVE_TOLERANCE)
    return effects - basis @ (basis.T @ effects)
