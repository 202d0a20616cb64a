"""Forces and regressor rows at instants of a motion, and derivatives with respect to motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.dynamics.newton_euler import Motion, base_wrench, joint_forces
from testbed.core.kernel.layout import Layout, make_layout
from testbed.core.kernel.records import Workspace, signals_of_motion
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.rules import Signal
from testbed.core.parameters.symbols import barycentric
from testbed.core.robot.tree import Joint, Tree

_CENTRAL_DIFFERENCE = (1.0, 0.5), (-1.0, -0.5)
_SMALL_SHIFT, _LARGE_SHIFT = np.pi / 4, 3 * np.pi / 4
_SMALL_WEIGHT, _LARGE_WEIGHT = (
    1 / (8 * np.sin(shift / 2) ** 2) for shift in (_SMALL_SHIFT, _LARGE_SHIFT)
)


@dataclass(frozen=True, eq=False)
class Stencil:
    """Finite-difference stencil in joint positions, velocities and accelerations.

    Attributes:
        shifts: Displacements of (q, qd, qdd) for E evaluations, (E, 3, n); the first is zero.
        weights: Weights of the E values in the derivatives with respect to q, then qd, then qdd,
            (3 n, E).
    """

    shifts: Array
    weights: Array

    def __post_init__(self) -> None:
        freeze_arrays(self, shifts=(None, 3, None))
        freeze_arrays(self, weights=(3 * self.shifts.shape[2], len(self.shifts)))

    def displaced_motion(self, motion: Motion) -> Motion:
        """Motion of E M samples: M samples, displaced by each of E shifts."""
        states = np.stack([motion.q, motion.qd, motion.qdd])
        displaced = states + self.shifts[:, :, None, :]  # (E, 3, M, n)
        columns = displaced.transpose(1, 0, 2, 3).reshape(3, -1, states.shape[2])
        return Motion(np.tile(motion.t, len(self.shifts)), *columns)


def derivative_stencil(tree: Tree) -> Stencil:
    """Finite-difference stencil for regressor rows and forces of a robot.

    The derivatives are exact, because regressor rows are trigonometric polynomials in revolute
    positions, quadratic in prismatic positions and in velocities, and linear in accelerations.

    Args:
        tree: The robot.
    """
    n = tree.n
    shifts, weights = [np.zeros((3, n))], [np.zeros((3, n))]
    for j, joint in enumerate(tree.joints):
        for order, displacements in enumerate(
            (_position_stencil(joint), _CENTRAL_DIFFERENCE, ((1.0, 1.0),))
        ):
            for shift, weight in displacements:
                direction = np.zeros((3, n))
                direction[order, j] = 1.0
                shifts.append(shift * direction)
                weights.append(weight * direction)
    weights[0][2] = -1.0  # accelerations enter linearly: one-sided difference
    return Stencil(np.array(shifts), np.reshape(weights, (-1, 3 * n)).T)


def _position_stencil(joint: Joint) -> tuple[tuple[float, float], ...]:
    """Shifts of a joint position [rad or m], and their weights in the derivative.

    Central differences are exact for the rows of a prismatic joint, which are quadratic in the
    position. Four shifts of +-45 and +-135 degrees are exact for the rows of a revolute joint,
    which are trigonometric polynomials of up to second order.
    """
    if not joint.revolute:
        return _CENTRAL_DIFFERENCE
    return (
        (_SMALL_SHIFT, _SMALL_WEIGHT),
        (-_SMALL_SHIFT, -_SMALL_WEIGHT),
        (_LARGE_SHIFT, -_LARGE_WEIGHT),
        (-_LARGE_SHIFT, _LARGE_WEIGHT),
    )


class SampledRows:
    """Regressor entries of a robot model at samples of a motion, from the compiled kernel.

    A slot is a nonzero entry of a channel's regressor row for the columns of the layout
    (barycentric parameters and joint laws). The regressor row for the base parameters is the
    product of the channel's slots and a constant matrix (`channels`). The compiled kernel is used
    for any number of samples, since a search evaluates the same few hundred samples thousands of
    times.
    """

    def __init__(
        self, tree: Tree, minimal: MinimalSet, joints: Sequence[int] | None = None
    ) -> None:
        """Prepare the layout of the rows.

        Args:
            tree: The robot, with a-priori inertias.
            minimal: Base parameters: delta_d for torque rows, delta_r for wrench rows.
            joints: Columns of a motion that belong to the tree's joints, if the tree is a part of
                the moving robot; default all columns.
        """
        self._joints = slice(None) if joints is None else np.array(joints)
        self.minimal = minimal
        self.layout: Layout = make_layout(tree, minimal)
        self.delta = minimal.values(barycentric(tree))
        self._width = len(self.layout.channel_columns)

    def slots(self, motion: Motion) -> Array:
        """Regressor entries of all slots at M samples of a motion, (slots, M)."""
        from testbed.core.kernel import (
            numba_engine,  # a second to import: random motions do not need it
        )

        states = (motion.q, motion.qd, motion.qdd)
        q, qd, qdd = (np.array(signal[:, self._joints], order="C") for signal in states)
        signals = signals_of_motion(q, qd, qdd, self._width)
        if self._workspace is None:
            self._workspace = numba_engine.workspace(self.layout, signals)
        blocks = numba_engine.rows(self.layout, signals, self._workspace)
        return np.concatenate([block.rows for block in blocks], axis=1)

    _workspace: Workspace | None = None

    def channels(self) -> Iterator[tuple[slice, Array]]:
        """Yield the range of s slots of each channel, and their basis matrix, (s, N).

        The product of slots, (M, s), and basis matrix is the regressor of N base parameters,
        (M, N).
        """
        rows = self.layout.rows
        for start, columns in zip(rows.start, self.layout.channel_columns, strict=True):
            yield (
                slice(int(start), int(start) + len(columns)),
                self.layout.basis[columns],
            )

    @cached_property
    def model(self) -> Array:
        """Matrix that maps slots to forces of the a-priori model, (channels, slots).

        Forces are joint forces or components of the wrench.
        """
        matrix = np.zeros((self._width, self.layout.rows.slots))
        for c, (slots, basis) in enumerate(self.channels()):
            matrix[c, slots] = basis @ self.delta
        return matrix


MIN_RELATIVE_SCALE = 0.05
"""Smallest scale of a parameter, relative to the largest parameter with the same unit."""


@dataclass(frozen=True, eq=False)
class NewtonEulerForces:
    """Forces at G instants of a motion, computed by the recursive Newton-Euler algorithm.

    The algorithm is independent of the kernel of the search, and therefore used for proofs.

    Attributes:
        tree: The robot.
        motion: Motion of G samples.
    """

    tree: Tree
    motion: Motion

    def forces(self, model: Signal) -> Array:
        """Joint forces for the signal "torque", else bedplate wrench, (channels, G) [N m, N]."""
        function = joint_forces if model == "torque" else base_wrench
        return function(self.tree, self.motion).T


@dataclass(frozen=True, eq=False)
class KernelForces:
    """Forces and regressor rows at G instants from the kernel, with finite-difference derivatives.

    Attributes:
        motion: Motion of G samples.
        rows: Sampled rows, keyed by signal.
        stencil: Finite-difference stencil; None for no derivatives.
    """

    motion: Motion
    rows: Mapping[Signal, SampledRows]
    stencil: Stencil | None

    @cached_property
    def slots(self) -> Mapping[Signal, Array]:
        """Regressor entries at E shifts of the stencil, keyed by signal, (slots, E, G).

        The first shift is zero.
        """
        motion = self.motion
        displaced = (
            motion if self.stencil is None else self.stencil.displaced_motion(motion)
        )
        return {
            model: rows.slots(displaced).reshape(
                rows.layout.rows.slots, -1, motion.samples
            )
            for model, rows in self.rows.items()
        }

    @cached_property
    def _shifted_forces(self) -> Mapping[Signal, Array]:
        """Forces of the a-priori model at E shifts, keyed by signal, (channels, E, G)."""
        return {
            model: np.tensordot(rows.model, self.slots[model], 1)
            for model, rows in self.rows.items()
        }

    def forces(self, model: Signal) -> Array:
        """Joint forces or bedplate wrench of the a-priori model, (channels, G) [N m, N]."""
        return self._shifted_forces[model][:, 0]

    def force_slopes(self, model: Signal) -> Array:
        """Derivatives of the forces with respect to q, then qd, then qdd, (channels, 3 n, G)."""
        assert self.stencil is not None, "derivatives were not asked for"
        return np.asarray(np.matmul(self.stencil.weights, self._shifted_forces[model]))


MotionSamples: TypeAlias = KernelForces | NewtonEulerForces
"""Forces of an a-priori model at G instants of a motion."""
