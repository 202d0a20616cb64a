"""Constant torques of the joints."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class ConstantTorque(JointFamily):
    """Constant torques of the joints."""

    kind = "torque_offset"
    label = "offsets of the torques"
    meaning = (
        "an amplifier with a zero error, or a spring or weight with a constant torque"
    )
    remedy = "estimate them: --terms coulomb,viscous,offset"

    def torques(self, point: Linearization) -> Array:
        """Constant torque of each joint, (m, n, 1) [N m or N]."""
        return (
            0.02 * point.sizes.torque[:, None] * np.ones((*point.joint_torque.shape, 1))
        )
