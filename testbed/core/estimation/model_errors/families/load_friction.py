"""Friction proportional to the load."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class FrictionByLoad(JointFamily):
    """Friction proportional to the load."""

    kind = "load_friction"
    label = "friction by the load"
    meaning = "gears whose friction grows with the torque that they carry"
    remedy = "let held-out data choose the terms: --terms auto"
    is_term = True

    def torques(self, point: Linearization) -> Array:
        """Product of the bodies' absolute torque and the sign of velocity, (m, n, 1) [N m or N]."""
        return 0.1 * (np.abs(point.forces.torque) * point.smooth_sign)[..., None]
