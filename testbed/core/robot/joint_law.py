"""Law of a joint's torque: a column of velocity and acceleration, times a coefficient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.codec import named
from testbed.core.robot.tree import Joint, Tree


@dataclass(frozen=True)
class JointLaw:
    """One kind of term of the joints' torques; every joint has a coefficient of its own.

    Attributes:
        kind: Its name: the estimate calls the coefficients `kind/JOINT`.
        turning: Unit of the coefficient at a revolute joint.
        sliding: Unit of the coefficient at a prismatic joint.
        column: What the coefficient multiplies: a function of velocity and acceleration
            [rad/s or m/s, rad/s^2 or m/s^2], element by element. Those in LAWS are
            compiled for single numbers, too: arithmetic and NumPy's functions only.
        parameter: The field of `Joint` that holds the model file's coefficient; None where
            no model file states one.
        resists: Whether it takes energy from the motion, as friction does: such a
            coefficient cannot be negative.
        jumps: Whether the column jumps where the motion reverses.
        by: What of the recording multiplies the column, joint by joint: "time" since its middle
            [s], "temperature" above 25 degC [K], one of BY_LOAD; "" for nothing. Of joints only,
            not of shafts.
    """

    kind: str
    turning: str
    sliding: str
    column: Callable[[Any, Any], Any]
    parameter: str | None = None
    resists: bool = False
    jumps: bool = False
    by: str = ""

    __get_pydantic_core_schema__ = named(lambda law: law.kind)

    def unit(self, joint: Joint) -> str:
        """Unit of the coefficient at a joint."""
        return self.turning if joint.revolute else self.sliding

    def coefficients(self, tree: Tree) -> Array:
        """What the model file states, (n,); zero where it states nothing."""
        if self.parameter is None:
            return np.zeros(tree.n)
        return np.array(
            [getattr(joint, self.parameter) for joint in tree.joints], dtype=float
        )

    def columns(self, qd: Array, qdd: Array, smooth: float = 0.0) -> Array:
        """The column of every joint, shaped as `qd`.

        Args:
            qd: Velocities [rad/s or m/s].
            qdd: Accelerations, of the same shape [rad/s^2 or m/s^2].
            smooth: Speed over which a jump is smoothed [rad/s or m/s]; 0 for none.
        """
        found: Array = np.broadcast_to(self.column(qd, qdd), np.shape(qd))
        return np.abs(found) * np.tanh(qd / smooth) if self.jumps and smooth else found
