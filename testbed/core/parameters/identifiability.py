"""Identifiability map: standard parameters that each instrument can identify.

Each of the ten standard parameters of every body is identifiable alone, only in combination with
other parameters, or not at all. The map is computed for joint torques and for three variants of the
bedplate, from the model alone, before any measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from testbed.core.base.arrays import Array
from testbed.core.parameters.elimination import (
    barycentric_rows,
    static_wrench_parameters,
)
from testbed.core.parameters.minimal_set import MinimalSet, known_zero_mask, minimal_set
from testbed.core.parameters.regroup import regroup_bodies
from testbed.core.parameters.symbols import forms_on_standard, standard_from_barycentric
from testbed.core.robot.tree import Tree

NOT_IDENTIFIABLE, IDENTIFIABLE_IN_COMBINATION, IDENTIFIABLE_ALONE = 0, 1, 2
"""Levels of a parameter: not identifiable, identifiable in combination, identifiable alone."""

INSTRUMENTS = ("torques", "bedplate", "tared bedplate", "bedplate, pedestal unknown")
"""Joint torques; the bedplate; the bedplate after subtraction of the static wrench in one posture;
the bedplate with a pedestal of unknown mass and moments."""

_TOLERANCE = 1e-9
"""Magnitude below which components inside or outside the identifiable space count as zero."""


@dataclass(frozen=True, eq=False)
class InstrumentIdentifiability:
    """Identifiability of the standard parameters by an instrument.

    Attributes:
        instrument: Name: one of INSTRUMENTS, or "force sensor", "force sensor, tared".
        count: Number of identifiable combinations, including those of an unknown pedestal.
        standard: NOT_IDENTIFIABLE, IDENTIFIABLE_IN_COMBINATION or IDENTIFIABLE_ALONE for each
            standard parameter, (n, 10), in the order m mx my mz Ixx Ixy Iyy Ixz Iyz Izz.
    """

    instrument: str
    count: int
    standard: NDArray[np.int_]


def identifiability(
    tree: Tree, gravity: ArrayLike | None = None, zeros: bool | Sequence[str] = False
) -> tuple[InstrumentIdentifiability, ...]:
    """Identifiability of every standard parameter by INSTRUMENTS, or by the robot's force sensor.

    Args:
        tree: The robot; its inertias matter only for `zeros`.
        gravity: Gravity, (3,) [m/s^2], bedplate frame; default the model file's.
        zeros: Barycentric parameters known to be zero, as in `minimal_set`.

    Returns:
        Identifiability for each of INSTRUMENTS, in this order; for a part of a robot on a force
        sensor, identifiability for "force sensor" and "force sensor, tared".
    """
    g = tree.gravity_or(gravity)
    plate = _sparse_combinations(minimal_set(tree, "wrench", g, zeros))
    tared = _sparse_combinations(minimal_set(tree, "wrench", g, zeros, tared=True))
    identity = np.eye(10 * tree.n)
    barycentric_matrix = sparse.csr_array(forms_on_standard(tree, identity))
    inverse = sparse.csr_array(
        standard_from_barycentric(tree, identity.reshape(tree.n, 10, -1)).reshape(
            identity.shape
        )
    )
    if tree.sensor is None:
        torques = _sparse_combinations(minimal_set(tree, "torque", g, zeros))
        sets = (torques, plate, tared, _with_unknown_pedestal(tree, g, zeros, tared))
        named_sets = list(zip(INSTRUMENTS, sets, strict=True))
    else:
        named_sets = [("force sensor", plate), ("force sensor, tared", tared)]
    return tuple(
        InstrumentIdentifiability(
            name,
            combinations.rows.shape[0],
            combinations.levels(barycentric_matrix, inverse).reshape(tree.n, 10),
        )
        for name, combinations in named_sets
    )


@dataclass(frozen=True, eq=False)
class _Combinations:
    """Identifiable combinations of an instrument, as sparse matrices.

    Attributes:
        rows: Coefficients on the pedestal's unknowns, if any, and the 10 n barycentric parameters,
            one row per combination.
        lift: Right inverse of the rows: `rows @ lift` is the identity.
    """

    rows: sparse.csr_array
    lift: sparse.csc_array

    def levels(
        self, barycentric_matrix: sparse.sparray, inverse: sparse.sparray
    ) -> NDArray[np.int_]:
        """Identifiability level of every standard parameter, (10 n,).

        Let R be the matrix of the combinations on the standard parameters, and p' the unit row of a
        parameter. The level is IDENTIFIABLE_ALONE if p' is in the row space of R, so that
        p' = p' L R for any L with R L = 1; IDENTIFIABLE_IN_COMBINATION if the parameter has a
        coefficient in R; otherwise NOT_IDENTIFIABLE.

        Args:
            barycentric_matrix: Matrix from standard to barycentric parameters, (10 n, 10 n).
            inverse: Inverse of that matrix.
        """
        others = self.rows.shape[1] - barycentric_matrix.shape[1]
        conversion = sparse.block_diag(
            [sparse.eye_array(others), barycentric_matrix], format="csr"
        )
        rows = self.rows @ conversion
        parts = abs(self.rows) @ abs(conversion)  # may cancel, and leave rounding
        size, scale = (
            _largest_magnitudes(rows),
            np.maximum(1.0, _largest_magnitudes(parts)),
        )
        projection = sparse.csr_array((inverse @ self.lift[others:]) @ rows)
        outside = _largest_magnitudes(
            sparse.eye_array(*projection.shape, k=others) - projection, axis=1
        )
        levels = np.full(barycentric_matrix.shape[1], NOT_IDENTIFIABLE)
        levels[(size > _TOLERANCE * scale)[others:]] = IDENTIFIABLE_IN_COMBINATION
        levels[outside <= _TOLERANCE] = IDENTIFIABLE_ALONE
        return levels


def _sparse_combinations(minimal: MinimalSet) -> _Combinations:
    """Identifiable combinations of a minimal set, as sparse matrices."""
    return _Combinations(
        sparse.csr_array(minimal.matrix), sparse.csc_array(minimal.lift)
    )


def _largest_magnitudes(matrix: sparse.sparray, axis: int = 0) -> Array:
    """Largest magnitude in each column (axis 0) or in each row (axis 1) of a sparse matrix."""
    maxima = abs(sparse.csr_array(matrix)).max(axis=axis) if min(matrix.shape) else None
    return (
        np.zeros(matrix.shape[1 - axis]) if maxima is None else maxima.toarray().ravel()
    )


def _with_unknown_pedestal(
    tree: Tree, gravity: Array, zeros: bool | Sequence[str], tared: _Combinations
) -> _Combinations:
    """Identifiable combinations of a bedplate with a pedestal of unknown mass and moments.

    The pedestal adds one unknown to each parameter of the static wrench (total mass and first
    moments); without gravity there are none. The columns belong to these unknowns, then to the 10 n
    barycentric parameters.

    Args:
        tree: The robot.
        gravity: Gravity, (3,) [m/s^2], bedplate frame.
        zeros: Barycentric parameters known to be zero, as in `minimal_set`.
        tared: Combinations of the tared bedplate.
    """
    static = np.zeros((0, 10 * tree.n))
    if gravity.any():
        bodies = regroup_bodies(tree, "wrench", gravity)
        static = barycentric_rows(tree, bodies, static_wrench_parameters(tree, gravity))
        static[:, known_zero_mask(tree, zeros).ravel()] = 0.0
    pedestal = sparse.eye_array(len(static))
    static_rows = sparse.csr_array(static)
    rows = sparse.block_array(
        [[None, tared.rows], [pedestal, static_rows]], format="csr"
    )
    lift = sparse.block_array(
        [[-static_rows @ tared.lift, pedestal], [tared.lift, None]], format="csc"
    )
    return _Combinations(rows, lift)
