"""The Cramer-Rao bound of the plate's white noise, with and without unknowns of the instrument.

Columns are exact, and made here from what the faults do: nothing of the product's nuisances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

import testbed as tb
from benchmarks.random_recordings import PLATE, happened
from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion, linear_inverse_dynamics
from testbed.core.parameters.minimal_set import MinimalSet

EVERY = 10
"""Samples of which one is looked at: motions are slow beside 1 kHz."""

TURN = 1e-5
"""Of a joint, by which derivatives are taken [rad, m]."""

IMITATED = 1e-6
"""Part of a column that others leave of it if they do not make it up."""


@dataclass(frozen=True, eq=False)
class Told:
    """What exact data would tell.

    Attributes:
        tree: The robot.
        motion: Its motion at M instants.
        wrench: Of robot and pedestal, (M, 6) [N, N m].
    """

    tree: tb.Tree
    motion: Motion
    wrench: Array


def least(
    tree: tb.Tree, minimal: MinimalSet, motion: str, seconds: float, seed: int,
    nuisances: Sequence[str] = (),
) -> Array:  # fmt: skip
    """Standard deviations that no unbiased estimate of the parameters falls below, (N,).

    `nuisances` are unknown beside the parameters.
    """
    time, truth, _ = happened(tree, motion, seconds, seed)
    part = slice(None, None, EVERY)
    assert truth.velocity is not None
    assert truth.acceleration is not None
    assert truth.wrench is not None
    signals = (time, truth.position, truth.velocity, truth.acceleration, truth.wrench)
    t, q, qd, qdd, wrench = (signal[part] for signal in signals)
    told = Told(tree, Motion(t, q, qd, qdd), wrench)
    lift = minimal.lift.reshape(tree.n, 10, -1)
    columns = [linear_inverse_dynamics(tree, told.motion, lift, tree.gravity)[1]]
    columns += [COLUMNS[kind](told) for kind in nuisances]
    sigma = np.repeat([PLATE.force_noise, PLATE.moment_noise], 3)
    every = np.concatenate(columns, axis=2) / sigma[:, None]
    rows = every.reshape(-1, every.shape[2])
    size = np.linalg.norm(rows, axis=0)
    own = np.abs(np.diagonal(np.linalg.qr(rows / size, mode="r")))
    kept = rows[:, own > IMITATED]  # parameters come first: what they imitate is left out
    assert (own[: minimal.count] > IMITATED).all()
    inverse = np.linalg.inv(np.linalg.qr(kept / size[own > IMITATED], mode="r"))
    spread = np.linalg.norm(inverse, axis=1) / size[own > IMITATED]
    return np.asarray(spread[: minimal.count] / np.sqrt(EVERY))


def _pose(told: Told) -> Array:
    force, moment = told.wrench[:, :3], told.wrench[:, 3:]
    turned = [np.hstack([np.cross(force, axis), np.cross(moment, axis)]) for axis in np.eye(3)]
    nothing = np.zeros_like(force)
    shifted = [np.hstack([nothing, np.cross(force, axis)]) for axis in np.eye(3)]
    return np.stack([*turned, *shifted], axis=2)


def _joint_zeros(told: Told) -> Array:
    slopes = []
    for joint in np.eye(told.tree.n):
        moved = (replace(told.motion, q=told.motion.q + x * TURN * joint) for x in (1, -1))
        ahead, behind = (tb.base_wrench(told.tree, each) for each in moved)
        slopes.append((ahead - behind) / (2 * TURN))
    return np.stack(slopes, axis=2)


COLUMNS: dict[str, Callable[[Told], Array]] = {
    "bias": lambda told: np.broadcast_to(np.eye(6), (len(told.wrench), 6, 6)),
    "slope": lambda told: told.motion.t[:, None, None] * np.eye(6),
    "pose": _pose,
    "height": lambda told: _pose(told)[..., 5:],
    "skew": lambda told: -np.gradient(told.wrench, told.motion.t, axis=0)[..., None],
    "joint_zeros": _joint_zeros,
}
"""What each kind adds to the wrench per unit, (M, 6, k)."""
