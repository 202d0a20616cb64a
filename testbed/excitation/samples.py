"""A motion at some instants: where the joints are, and what forces that takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import base_wrench, joint_forces
from testbed.dynamics.motion import Motion
from testbed.excitation.sampled_rows import SampledRows
from testbed.excitation.stencil import Stencil
from testbed.parameters.rules import Model
from testbed.robot.tree import Tree


class Instants(Protocol):
    """G instants of a motion, and forces by an a-priori model."""

    @property
    def q(self) -> Array:
        """Positions, (G, n) [rad or m]."""

    @property
    def qd(self) -> Array:
        """Velocities, (G, n) [rad/s or m/s]."""

    @property
    def qdd(self) -> Array:
        """Accelerations, (G, n) [rad/s^2 or m/s^2]."""

    def forces(self, model: Model) -> Array:
        """Joint forces or bedplate wrench, the pedestal's aside, (channels, G) [N m, N]."""


@dataclass(frozen=True, eq=False)
class Computed:
    """Instants whose forces come from the recursion of `dynamics`: the proof's witness.

    Attributes:
        tree: The robot.
        motion: G samples.
    """

    tree: Tree
    motion: Motion

    @property
    def q(self) -> Array:
        """Positions, (G, n) [rad or m]."""
        return self.motion.q

    @property
    def qd(self) -> Array:
        """Velocities, (G, n) [rad/s or m/s]."""
        return self.motion.qd

    @property
    def qdd(self) -> Array:
        """Accelerations, (G, n) [rad/s^2 or m/s^2]."""
        return self.motion.qdd

    def forces(self, model: Model) -> Array:
        """Joint forces or bedplate wrench, (channels, G)."""
        found = joint_forces if model == "dynamic" else base_wrench
        return found(self.tree, self.motion).T


@dataclass(frozen=True, eq=False)
class Samples:
    """G instants in a search, rows by the kernel, with looks around them for derivatives.

    Attributes:
        q: Positions, (G, n) [rad or m].
        qd: Velocities, (G, n) [rad/s or m/s].
        qdd: Accelerations, (G, n) [rad/s^2 or m/s^2].
        rows: Rows of the models that are looked at.
        stencil: For derivatives; None if they are not wanted.
    """

    q: Array
    qd: Array
    qdd: Array
    rows: Mapping[Model, SampledRows]
    stencil: Stencil | None

    @cached_property
    def slots(self) -> Mapping[Model, Array]:
        """Slots of each model at each look, (slots, E, G); the first look is the motion."""
        motion = (self.q, self.qd, self.qdd)
        looks = motion if self.stencil is None else self.stencil.around(*motion)
        return {
            model: rows.slots(*looks).reshape(rows.layout.rows.slots, -1, len(self.q))
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
        found: Array = self._seen[model][:, 0]
        return found

    def force_slopes(self, model: Model) -> Array:
        """Their derivatives by q, then qd, then qdd, (channels, 3 n, G)."""
        assert self.stencil is not None, "derivatives were not asked for"
        return np.asarray(np.matmul(self.stencil.weights, self._seen[model]))
