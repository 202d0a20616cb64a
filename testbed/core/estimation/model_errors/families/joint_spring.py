"""Torque as a function of the joint's position, such as that of a hose."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class JointSpring(JointFamily):
    """Torque as a function of the joint's position, such as that of a hose."""

    kind = "joint_spring"
    label = "a torque by the position"
    meaning = "a hose, a cable bundle or a spring at the joint"
    remedy = (
        "fasten hoses close to the joint axes; leave them off in a second recording"
    )

    def torques(self, point: Linearization) -> Array:
        """Torques linear and quadratic in the centred joint position, (m, n, 2) [N m or N]."""
        position = (point.motion.q - point.sizes.middle) / point.sizes.range
        return (
            0.02
            * point.sizes.torque[:, None]
            * np.stack([position, position**2], axis=2)
        )
