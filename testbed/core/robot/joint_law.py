"""Joint torque law: a function of velocity and acceleration times one coefficient per joint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.codec import schema_by_name
from testbed.core.robot.tree import Joint, Tree


@dataclass(frozen=True)
class JointLaw:
    """Term of the joint torques: a regressor column times one coefficient per joint.

    Attributes:
        kind: Name of the law; the coefficients are named `kind/JOINT` in estimates.
        revolute_unit: Unit of the coefficient at a revolute joint.
        prismatic_unit: Unit of the coefficient at a prismatic joint.
        column: Regressor column as a function of velocity and acceleration [rad/s or m/s, rad/s^2
            or m/s^2], evaluated element by element. Columns of JOINT_LAWS are also compiled for
            scalars, and may therefore use only arithmetic and NumPy functions.
        parameter: Field of `Joint` that holds the coefficient of the model file; None if model
            files do not state the coefficient.
        dissipative: True for a dissipative law such as friction, whose coefficient cannot be
            negative.
        discontinuous: True if the column is discontinuous where the velocity changes sign.
        by: Signal of each joint in the recording by which the column is multiplied: "time" since
            the middle of the recording [s], "temperature" above 25 degC [K] or a key of
            LOAD_MULTIPLIERS; "" for no multiplier. A law with a multiplier applies to joints only,
            not to shafts.
    """

    kind: str
    revolute_unit: str
    prismatic_unit: str
    column: Callable[[Any, Any], Any]
    parameter: str | None = None
    dissipative: bool = False
    discontinuous: bool = False
    by: str = ""

    __get_pydantic_core_schema__ = schema_by_name(lambda law: law.kind)

    def unit(self, joint: Joint) -> str:
        """Unit of the coefficient at a revolute or prismatic joint."""
        return self.revolute_unit if joint.revolute else self.prismatic_unit

    def coefficients(self, tree: Tree) -> Array:
        """Coefficients of all joints in the model file, (n,); zeros if `parameter` is None."""
        if self.parameter is None:
            return np.zeros(tree.n)
        return np.array(
            [getattr(joint, self.parameter) for joint in tree.joints], dtype=float
        )

    def columns(self, qd: Array, qdd: Array, smooth: float = 0.0) -> Array:
        """Regressor columns of all joints, with the shape of `qd`.

        Args:
            qd: Joint velocities, (..., n) [rad/s or m/s].
            qdd: Joint accelerations, same shape [rad/s^2 or m/s^2].
            smooth: Speed v0 [rad/s or m/s]: the column of a discontinuous law is replaced by its
                magnitude times tanh(qd / v0); 0 for no smoothing.
        """
        columns: Array = np.broadcast_to(self.column(qd, qdd), np.shape(qd))
        return (
            np.abs(columns) * np.tanh(qd / smooth)
            if self.discontinuous and smooth
            else columns
        )
