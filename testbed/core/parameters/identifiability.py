"""The identifiability map: which standard parameters an instrument can ever identify.

For every body and each of its ten URDF-style parameters: identifiable alone, only in combination
with others, or never; by joint torques and by the bedplate under four circumstances.
Computed from the model alone, before any data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from testbed.core.base.arrays import Array
from testbed.core.parameters.elimination import dense_rows, static_entries
from testbed.core.parameters.minimal_set import MinimalSet, known_zeros, minimal_set
from testbed.core.parameters.regroup import regroup
from testbed.core.parameters.symbols import on_standard, to_standard
from testbed.core.robot.tree import Tree

NEVER, COMBINED, ALONE = 0, 1, 2

INSTRUMENTS = ("torques", "bedplate", "tared bedplate", "bedplate, pedestal unknown")
"""Joint torques; the bedplate; the bedplate with its static wrench in one posture taken off;
the bedplate where the pedestal's mass and moments on the sensor are unknown as well."""

_CLEAR = 1e-9
"""Part of a unit parameter in, or outside, what is identifiable that counts as none."""


@dataclass(frozen=True, eq=False)
class Visibility:
    """What one sensor identifies.

    Attributes:
        instrument: One of INSTRUMENTS.
        count: Number of identifiable combinations, the pedestal's own included if unknown.
        standard: Of the standard parameters: NEVER, COMBINED or ALONE, (n, 10).
    """

    instrument: str
    count: int
    standard: NDArray[np.int_]


def identifiability(
    tree: Tree, gravity: ArrayLike | None = None, zeros: bool | Sequence[str] = False
) -> tuple[Visibility, ...]:
    """What each of INSTRUMENTS, or the robot's force sensor, identifies of every parameter.

    Args:
        tree: The robot; its inertias matter only for `zeros`.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
        zeros: Barycentric parameters known to be zero, as in `minimal_set`.
    """
    g = tree.gravity_or(gravity)
    plate = _told(minimal_set(tree, "reaction", g, zeros))
    tared = _told(minimal_set(tree, "reaction", g, zeros, tared=True))
    own = np.eye(10 * tree.n)
    units = sparse.csr_array(on_standard(tree, own))
    back = sparse.csr_array(
        to_standard(tree, own.reshape(tree.n, 10, -1)).reshape(own.shape)
    )
    if tree.sensor is None:
        torques = _told(minimal_set(tree, "dynamic", g, zeros))
        sets = (torques, plate, tared, _beside_a_pedestal(tree, g, zeros, tared))
        named = list(zip(INSTRUMENTS, sets, strict=True))
    else:
        named = [("force sensor", plate), ("force sensor, tared", tared)]
    return tuple(
        Visibility(name, seen.rows.shape[0], seen.of(units, back).reshape(tree.n, 10))
        for name, seen in named
    )


@dataclass(frozen=True, eq=False)
class _Told:
    """The combinations that one instrument identifies, few numbers of them not zero.

    Attributes:
        rows: On other unknowns, if any, and the 10 n barycentric parameters.
        lift: Rows times this is 1.
    """

    rows: sparse.csr_array
    lift: sparse.csc_array

    def of(self, units: sparse.sparray, back: sparse.sparray) -> NDArray[np.int_]:
        """NEVER, COMBINED or ALONE for every parameter of a body.

        A parameter p' x is identifiable alone if p' is a combination of the rows R, and then it is
        p' L R, for any L with R L = 1.

        Args:
            units: The barycentric parameters of each of the bodies' parameters, (10 n, 10 n).
            back: Its inverse.
        """
        others = self.rows.shape[1] - units.shape[1]
        on_units = sparse.block_diag([sparse.eye_array(others), units], format="csr")
        rows = self.rows @ on_units
        parts = abs(self.rows) @ abs(on_units)  # what may cancel, and leave rounding
        size, scale = _largest(rows), np.maximum(1.0, _largest(parts))
        found = sparse.csr_array((back @ self.lift[others:]) @ rows)
        outside = _largest(sparse.eye_array(*found.shape, k=others) - found, axis=1)
        seen = np.full(units.shape[1], NEVER)
        seen[(size > _CLEAR * scale)[others:]] = COMBINED
        seen[outside <= _CLEAR] = ALONE
        return seen


def _told(minimal: MinimalSet) -> _Told:
    return _Told(sparse.csr_array(minimal.matrix), sparse.csc_array(minimal.lift))


def _largest(matrix: sparse.sparray, axis: int = 0) -> Array:
    found = abs(sparse.csr_array(matrix)).max(axis=axis) if min(matrix.shape) else None
    return (
        np.zeros(matrix.shape[1 - axis]) if found is None else found.toarray().ravel()
    )


def _beside_a_pedestal(
    tree: Tree, gravity: Array, zeros: bool | Sequence[str], tared: _Told
) -> _Told:
    """An unknown pedestal adds its own mass and moments to each static entry."""
    static = np.zeros((0, 10 * tree.n))
    if gravity.any():
        bodies = regroup(tree, "reaction", gravity)
        static = dense_rows(tree, bodies, static_entries(tree, gravity))
        static[:, known_zeros(tree, zeros).ravel()] = 0.0
    added = sparse.eye_array(len(static))
    weight = sparse.csr_array(static)
    rows = sparse.block_array([[None, tared.rows], [added, weight]], format="csr")
    lift = sparse.block_array(
        [[-weight @ tared.lift, added], [tared.lift, None]], format="csc"
    )
    return _Told(rows, lift)
