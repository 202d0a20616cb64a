"""The identifiability map: which standard parameters an instrument can ever tell.

For every body and each of its ten URDF-style parameters: told alone, only in combination
with others, or never; by joint torques and by the bedplate under four circumstances.
Computed from the model alone, before any data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.arrays import Array
from testbed.parameters.barycentric import standard_to_barycentric
from testbed.parameters.entries import dense_rows, static_entries
from testbed.parameters.minimal_set import known_zeros, minimal_set
from testbed.parameters.regroup import regroup
from testbed.robot.tree import Tree

NEVER, COMBINED, ALONE = 0, 1, 2

INSTRUMENTS = ("torques", "bedplate", "tared bedplate", "bedplate, pedestal unknown")
"""Joint torques; the bedplate; the bedplate with its static wrench in one posture taken off;
the bedplate where the pedestal's mass and moments on the sensor are unknown as well."""

_CLEAR = 1e-9
"""Part of a unit parameter in, or outside, the row space that counts as none."""


@dataclass(frozen=True, eq=False)
class Visibility:
    """What one instrument tells.

    Attributes:
        instrument: One of INSTRUMENTS.
        count: Number of combinations told, the pedestal's own included if unknown.
        standard: Of the standard parameters: NEVER, COMBINED or ALONE, (n, 10).
        barycentric: Likewise of the barycentric parameters, (n, 10).
    """

    instrument: str
    count: int
    standard: NDArray[np.int_]
    barycentric: NDArray[np.int_]


def identifiability(
    tree: Tree, gravity: ArrayLike | None = None, zeros: bool | Sequence[str] = False
) -> tuple[Visibility, ...]:
    """What each of INSTRUMENTS can tell about each parameter of each body.

    Args:
        tree: The robot; its inertias matter only for `zeros`.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
        zeros: Barycentric parameters known to be zero, as in `minimal_set`.
    """
    g = tree.gravity_or(gravity)
    torques = minimal_set(tree, "dynamic", g, zeros).matrix
    plate = minimal_set(tree, "reaction", g, zeros).matrix
    tared = minimal_set(tree, "reaction", g, zeros, tared=True).matrix
    static = np.zeros((0, 10 * tree.n))
    if g.any():
        bodies = regroup(tree, "reaction", g)
        static = dense_rows(tree, bodies, static_entries(tree, g))
        static[:, known_zeros(tree, zeros).ravel()] = 0.0
    moving = np.vstack([tared, static])
    # an unknown pedestal adds its own mass and moments to each static entry
    pedestal = np.eye(len(moving), len(static), -len(tared))
    unknown = np.hstack([pedestal, moving])
    cases = zip(INSTRUMENTS, (torques, plate, tared, unknown), strict=True)
    return tuple(_visibility(tree, name, rows) for name, rows in cases)


def _visibility(tree: Tree, instrument: str, rows: Array) -> Visibility:
    own = 10 * tree.n
    others = rows.shape[1] - own
    on_standard = np.hstack([rows[:, :others], rows[:, others:] @ standard_to_barycentric(tree)])
    return Visibility(
        instrument,
        len(rows),
        _seen(on_standard)[others:].reshape(tree.n, 10),
        _seen(rows)[others:].reshape(tree.n, 10),
    )


def _seen(rows: Array) -> NDArray[np.int_]:
    """NEVER, COMBINED or ALONE for every column: its parts in the row space and outside.

    Args:
        rows: Independent of each other, (k, columns).
    """
    basis = np.linalg.qr(rows.T)[0]  # (columns, k)
    inside = np.linalg.norm(basis, axis=1)
    outside = np.linalg.norm(np.eye(len(basis)) - basis @ basis.T, axis=0)
    seen = np.full(len(basis), NEVER)
    seen[inside > _CLEAR] = COMBINED
    seen[outside <= _CLEAR] = ALONE
    return seen
