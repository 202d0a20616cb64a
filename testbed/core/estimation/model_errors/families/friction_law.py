"""Friction that is not proportional to sign and speed."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class FrictionLaw(JointFamily):
    """Friction that is not proportional to sign and speed."""

    kind = "friction_law"
    label = "another friction model"
    meaning = "friction that falls at low speed or grows faster than the speed"
    remedy = "let held-out data choose the terms: --terms auto"
    is_term = True

    def torques(self, at: Linearization) -> Array:
        """Stribeck's friction, magnitude and square of the speed, (m, n, 4) [N m or N]."""
        speed = np.abs(at.motion.qd) / at.sizes.speed
        laws = [at.sense * np.exp(-speed / 0.03), at.sense * np.exp(-speed / 0.13)]
        laws += [speed, at.sense * speed**2]
        return 0.03 * at.sizes.torque[:, None] * np.stack(laws, axis=2)
