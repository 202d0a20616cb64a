"""Wrong torque constants."""

from __future__ import annotations

from collections.abc import Sequence

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.robot.tree import Tree


class TorqueGain(JointFamily):
    """Relative errors of the measured torques, one per joint."""

    kind = "torque_gain"
    label = "wrong torque constants"
    meaning = "torques on a wrong scale at single joints"
    remedy = "measure the torque constants with a known load, or by a force plate: `testbed drives`"

    def coefficient_scales(self, tree: Tree) -> Sequence[tuple[str, str, float]]:
        """Relative errors of the torques, as coefficients to be reported."""
        return [(f"gain/{name}", "", 0.05) for name in tree.names]

    def torques(self, point: Linearization) -> Array:
        """Change of each joint's torque due to a relative error of 5 %, (m, n, 1) [N m or N]."""
        return 0.05 * point.total_torque[..., None]
