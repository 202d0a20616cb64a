"""Rotations of gravity that joint torques cannot distinguish from other unknowns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array, skew
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import components
from testbed.core.dynamics.drive_set import random_states
from testbed.core.dynamics.newton_euler import Motion, linear
from testbed.core.dynamics.regressor import regressor
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.robot.tree import Tree

STEP = 1e-5
"""Of a joint's zero, for a derivative [rad or m]."""

ROUNDING = 1e-6
"""Share of an effect that is none."""


def unidentifiable_rotations(tree: Tree, minimal: MinimalSet) -> Diagnostic:
    """Axes about which joint torques show no small rotation of gravity, and what does the same.

    Effects of a rotation are held against those of the minimal parameters and of the joints'
    zeros, for random bodies at random states.

    Args:
        tree: The robot; only its geometry matters.
        minimal: Its dynamic set, under gravity.
    """
    rotations, parameters, zeros = _effects(tree, minimal)
    others = {
        "changes nothing": parameters[:, :0],
        "as other parameters": parameters,
    }
    for name, zero in zip(tree.names, zeros.T, strict=True):
        others[f"as another zero of '{name}'"] = np.column_stack([parameters, zero])
    every = others["as other zeros of joints"] = np.hstack([parameters, zeros])
    none = ROUNDING * float(np.linalg.norm(rotations))
    said = []
    for axis in _null_axes(_unexplained(rotations, every), none):
        same = (
            label
            for label, columns in others.items()
            if np.linalg.norm(_unexplained(rotations @ axis, columns)) <= 2 * none
        )
        said.append(f"{components(np.round(axis, 6) + 0.0)} ({next(same)})")
    return diagnose("gravity.rotation", ", ".join(said))


def _null_axes(columns: Array, none: float) -> Array:
    """Unit vectors that span the null space of columns (T, 3), unit axes where these do."""
    from scipy.linalg import qr, svd

    _, sizes, axes = svd(columns)
    hidden = axes[sizes <= none]
    projector = hidden.T @ hidden
    _, pivots = qr(np.round(projector, 9), mode="r", pivoting=True)
    rows: Array = projector[np.sort(pivots[: len(hidden)])]
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def _effects(tree: Tree, minimal: MinimalSet) -> tuple[Array, Array, Array]:
    """Effects on T torques: rotations of gravity (T, 3), minimal parameters, joints' zeros."""
    states, gravity = random_states(tree), minimal.gravity
    bodies = np.random.default_rng(0).normal(size=(tree.n, 10, 1))
    bodies *= ~minimal.known_zero[..., None]

    def torques(motion: Motion, gravity: Array) -> Array:
        return linear(tree, motion, bodies, gravity)[0].ravel()

    rest = Motion.at_rest(states.q)
    rotations = np.stack([torques(rest, each) for each in skew(gravity)], axis=1)
    shifted = [
        torques(replace(states, q=states.q + shift), gravity)
        for shift in STEP * np.vstack([np.eye(tree.n), -np.eye(tree.n)])
    ]
    zeros = np.subtract(*np.split(np.stack(shifted, axis=1), 2, axis=1)) / (2 * STEP)
    parameters = regressor(tree, states, minimal).reshape(len(zeros), -1)
    return rotations, parameters, zeros


def _unexplained(effects: Array, others: Array) -> Array:
    """What linear combinations of others leave of effects, (T,) or (T, k)."""
    from scipy.linalg import orth

    basis: Array = orth(others, ROUNDING)
    return effects - basis @ (basis.T @ effects)
