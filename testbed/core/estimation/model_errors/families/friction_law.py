"""Friction that is not a linear function of sign and speed."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class FrictionLaw(JointFamily):
    """Friction that is not a linear function of sign and speed."""

    kind = "friction_law"
    label = "another friction model"
    meaning = "friction that falls at low speed or grows faster than the speed"
    remedy = "let held-out data choose the terms: --terms auto"
    is_term = True

    def torques(self, point: Linearization) -> Array:
        """Stribeck terms, absolute speed and signed square of speed, (m, n, 4) [N m or N].

        The two Stribeck terms decay exponentially, with decay speeds of 3 % and 13 % of the
        greatest speed. All columns are scaled by 3 % of the joint's greatest torque.
        """
        speed = np.abs(point.motion.qd) / point.sizes.speed
        laws = [
            point.smooth_sign * np.exp(-speed / 0.03),
            point.smooth_sign * np.exp(-speed / 0.13),
        ]
        laws += [speed, point.smooth_sign * speed**2]
        return 0.03 * point.sizes.torque[:, None] * np.stack(laws, axis=2)
