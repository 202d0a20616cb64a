"""Coefficients of the joints' own torque as unknowns of a motion: columns, with derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.robot.friction import BY_LOAD, JointLaw
from testbed.core.robot.tree import Tree

SMOOTH = 0.05
"""Speed over which the sign of dry friction is smoothed, for derivatives [rad/s or m/s]."""

STEP = 2e-3 * SMOOTH
"""Of differences of order four by velocity: exact but for rounding for what changes over SMOOTH."""

SMALL = 0.05
"""Values below this share of the largest of their unit count as that large."""


def scale_of(values: Array, units: Sequence[str]) -> Array:
    """What a relative error is relative to: the values, small ones counted as larger.

    Args:
        values: (N,).
        units: Of each.
    """
    scale = np.abs(values)
    for unit in set(units):
        same = np.array([u == unit for u in units])
        scale[same] = np.maximum(scale[same], SMALL * scale[same].max())
    return scale


@dataclass(frozen=True, eq=False)
class JointUnknowns:
    """Coefficients of laws at all joints, and torque constants where these are unknown, too.

    Attributes:
        laws: Each has a coefficient at every joint; those by time or temperature are none.
        first: Place of the first among the unknowns: law by law, joint by joint.
        scale: Units of the coefficients, (laws, n).
        values: By the model file, in these units, (laws, n).
        constants: Place of the first torque constant; None where they are known.
    """

    laws: tuple[JointLaw, ...]
    first: int
    scale: Array
    values: Array
    constants: int | None = None

    @staticmethod
    def relative(tree: Tree, laws: tuple[JointLaw, ...], constants: int) -> JointUnknowns:
        """Of laws, and torque constants before them, in units of their values.

        A coefficient that the model file does not state has the unit 1.

        Args:
            tree: The robot.
            laws: Their names.
            constants: Place of the first torque constant.
        """
        values = np.array([law.coefficients(tree) for law in laws])
        units = [[law.unit(joint) for joint in tree.joints] for law in laws]
        scale = np.array([scale_of(v, u) for v, u in zip(values, units, strict=True)])
        scale[scale == 0] = 1.0
        return JointUnknowns(laws, constants + tree.n, scale, values / scale, constants)

    def add(self, rows: Array, joint: int, qd: Array, qdd: Array, load: Array) -> None:
        """Adds a joint's columns to its rows, (G, U).

        Args:
            rows: So far what the bodies make of them, and of the torque constant's column.
            joint: Its index.
            qd: Velocity, (G,) [rad/s or m/s].
            qdd: Acceleration, (G,) [rad/s^2 or m/s^2].
            load: Torque that moves its link, (G,) [N m or N].
        """
        columns = self._columns(joint, qd, qdd, load)
        rows[:, self._places(joint)] = columns.T
        if self.constants is not None:  # it multiplies friction as well
            rows[:, self.constants + joint] += self.values[:, joint] @ columns

    def slopes(self, joint: int, by: Array, qd: Array, qdd: Array, load: Array) -> Array:
        """Derivatives by velocity, acceleration and load, (3, G), given those by the rows.

        Args:
            joint: Its index.
            by: Derivatives by all unknowns' columns, (U, G).
            qd: Velocity, (G,) [rad/s or m/s].
            qdd: Acceleration, (G,) [rad/s^2 or m/s^2].
            load: Torque that moves its link, (G,) [N m or N].
        """
        weights = by[self._places(joint)]
        if self.constants is not None:
            weights = weights + np.outer(self.values[:, joint], by[self.constants + joint])

        def at(speed: float, rate: float, share: float = 1.0) -> Array:
            return self._columns(joint, qd + speed, qdd + rate, share * load)

        near, far = (at(k * STEP, 0) - at(-k * STEP, 0) for k in (1, 2))
        by_qd = (8 * near - far) / (12 * STEP)
        by_qdd = (at(0, 1) - at(0, -1)) / 2
        # of degree none, one or two in the load: so wide a difference is exact
        wide = at(0, 0, 1.5) - at(0, 0, 0.5)
        by_load = np.divide(wide, load, out=np.zeros_like(wide), where=load != 0)
        return np.array([np.sum(weights * each, axis=0) for each in (by_qd, by_qdd, by_load)])

    def _places(self, joint: int) -> slice:
        """Of a joint's coefficients among the unknowns."""
        return slice(self.first + joint, self.first + self.scale.size, self.scale.shape[1])

    def _columns(self, joint: int, qd: Array, qdd: Array, load: Array) -> Array:
        """What a joint's coefficients multiply, (laws, G)."""
        by = [BY_LOAD[law.by](load, load) if law.by else 1.0 for law in self.laws]
        made = [law.columns(qd, qdd, SMOOTH) * b for law, b in zip(self.laws, by, strict=True)]
        return self.scale[:, [joint]] * np.array(made)
