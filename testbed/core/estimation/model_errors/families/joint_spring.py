"""Torques by the position of a joint, as of a hose."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class JointSpring(JointFamily):
    """Torques by the position of a joint, as of a hose."""

    kind = "joint_spring"
    label = "a torque by the position"
    meaning = "a hose, a cable bundle or a spring at the joint"
    remedy = (
        "fasten hoses close to the joint axes; leave them off in a second recording"
    )

    def torques(self, at: Linearization) -> Array:
        """Position and its square, (m, n, 2) [N m or N]."""
        position = (at.motion.q - at.sizes.middle) / at.sizes.range
        return (
            0.02 * at.sizes.torque[:, None] * np.stack([position, position**2], axis=2)
        )
