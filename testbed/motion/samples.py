"""A motion at some instants: positions, forces, rows of a model, with exact derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.dynamics.newton_euler import Motion, base_wrench, joint_forces
from testbed.core.kernel.layout import Layout, layout
from testbed.core.kernel.records import Work, sensed
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.rules import Model
from testbed.core.parameters.symbols import barycentric
from testbed.core.robot.tree import Joint, Tree

_STRAIGHT = (1.0, 0.5), (-1.0, -0.5)
_NEAR, _FAR = np.pi / 4, 3 * np.pi / 4
_OF_NEAR, _OF_FAR = (1 / (8 * np.sin(shift / 2) ** 2) for shift in (_NEAR, _FAR))


@dataclass(frozen=True, eq=False)
class Stencil:
    """Finite-difference stencil in joint positions, velocities and accelerations.

    Attributes:
        shifts: Displacements of (q, qd, qdd), (E, 3, n); the first is zero.
        weights: Derivatives by q, then qd, then qdd, of values at the shifts, (3 n, E).
    """

    shifts: Array
    weights: Array

    def __post_init__(self) -> None:
        freeze(self, shifts=(None, 3, None))
        freeze(self, weights=(3 * self.shifts.shape[2], len(self.shifts)))

    def around(self, motion: Motion) -> Motion:
        """Motion of M samples displaced by each of the E shifts in turn, E M samples."""
        states = np.stack([motion.q, motion.qd, motion.qdd])
        moved = states + self.shifts[:, :, None, :]  # (E, 3, M, n)
        flat = moved.transpose(1, 0, 2, 3).reshape(3, -1, states.shape[2])
        return Motion(np.tile(motion.t, len(self.shifts)), *flat)


def stencil(tree: Tree) -> Stencil:
    """The stencil of a robot's rows.

    Args:
        tree: The robot.
    """
    n = tree.n
    shifts, weights = [np.zeros((3, n))], [np.zeros((3, n))]
    for j, joint in enumerate(tree.joints):
        for order, looks in enumerate((_position(joint), _STRAIGHT, ((1.0, 1.0),))):
            for shift, weight in looks:
                one = np.zeros((3, n))
                one[order, j] = 1.0
                shifts.append(shift * one)
                weights.append(weight * one)
    weights[0][2] = -1.0  # of accelerations, which count in proportion
    return Stencil(np.array(shifts), np.reshape(weights, (-1, 3 * n)).T)


def _position(joint: Joint) -> tuple[tuple[float, float], ...]:
    """Shifts of a position and their weights."""
    if not joint.revolute:
        return _STRAIGHT
    return (_NEAR, _OF_NEAR), (-_NEAR, -_OF_NEAR), (_FAR, -_OF_FAR), (-_FAR, _OF_FAR)


class SampledRows:
    """Slots of one model's rows: what each is worth, the layout says.

    The compiled kernel is used whatever the size: a search asks for the same few hundred
    samples thousands of times.
    """

    def __init__(
        self, tree: Tree, minimal: MinimalSet, joints: Sequence[int] | None = None
    ) -> None:
        """Lay the rows out.

        Args:
            tree: The robot, its inertias an a-priori model.
            minimal: delta_d for rows of the joints, delta_r for those of the bedplate.
            joints: Columns of a motion that are the tree's, of a part of a robot; default all.
        """
        self._joints = slice(None) if joints is None else np.array(joints)
        self.minimal = minimal
        self.layout: Layout = layout(tree, minimal)
        self.delta = minimal.values(barycentric(tree))
        self._width = len(self.layout.channels)

    def slots(self, motion: Motion) -> Array:
        """All slots of a motion of M samples, (slots, M)."""
        from testbed.core.kernel import (
            numba_engine,  # a second to import: random motions do not need it
        )

        states = (motion.q, motion.qd, motion.qdd)
        q, qd, qdd = (np.array(each[:, self._joints], order="C") for each in states)
        signals = sensed(q, qd, qdd, self._width)
        if self._room is None:
            self._room = numba_engine.workspace(self.layout, signals)
        made = numba_engine.rows(self.layout, signals, self._room)
        return np.concatenate([block.rows for block in made], axis=1)

    _room: Work | None = None

    def channels(self) -> Iterator[tuple[slice, Array]]:
        """Slots of each channel, and what they have of each minimal parameter, (s, N)."""
        rows = self.layout.rows
        for start, columns in zip(rows.start, self.layout.channels, strict=True):
            yield (
                slice(int(start), int(start) + len(columns)),
                self.layout.basis[columns],
            )

    @cached_property
    def model(self) -> Array:
        """What slots are worth by the a-priori model, (channels, slots): forces or wrench."""
        found = np.zeros((self._width, self.layout.rows.slots))
        for c, (part, lead) in enumerate(self.channels()):
            found[c, part] = lead @ self.delta
        return found


SMALL = 0.05
"""Values below this share of the largest of their unit count as that large."""


@dataclass(frozen=True, eq=False)
class Computed:
    """Instants whose forces come from the recursion of `dynamics`: the proof's witness.

    Attributes:
        tree: The robot.
        motion: G samples.
    """

    tree: Tree
    motion: Motion

    def forces(self, model: Model) -> Array:
        """Joint forces or bedplate wrench, (channels, G)."""
        found = joint_forces if model == "dynamic" else base_wrench
        return found(self.tree, self.motion).T


@dataclass(frozen=True, eq=False)
class Samples:
    """G instants in a search, rows by the kernel, with looks around them for derivatives.

    Attributes:
        motion: G samples.
        rows: Rows of the models that are looked at.
        stencil: For derivatives; None if they are not wanted.
    """

    motion: Motion
    rows: Mapping[Model, SampledRows]
    stencil: Stencil | None

    @cached_property
    def slots(self) -> Mapping[Model, Array]:
        """Slots of each model at each look, (slots, E, G); the first look is the motion."""
        motion = self.motion
        looks = motion if self.stencil is None else self.stencil.around(motion)
        return {
            model: rows.slots(looks).reshape(rows.layout.rows.slots, -1, motion.samples)
            for model, rows in self.rows.items()
        }

    @cached_property
    def _seen(self) -> Mapping[Model, Array]:
        return {
            model: np.tensordot(rows.model, self.slots[model], 1)
            for model, rows in self.rows.items()
        }

    def forces(self, model: Model) -> Array:
        """Joint forces or bedplate wrench by the a-priori model, (channels, G) [N m, N]."""
        return self._seen[model][:, 0]

    def force_slopes(self, model: Model) -> Array:
        """Their derivatives by q, then qd, then qdd, (channels, 3 n, G)."""
        assert self.stencil is not None, "derivatives were not asked for"
        return np.asarray(np.matmul(self.stencil.weights, self._seen[model]))


MotionSamples: TypeAlias = Samples | Computed
"""G instants of a motion, and forces by an a-priori model."""
