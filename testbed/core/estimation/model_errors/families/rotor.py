"""Inertia of rotors."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Rotor(JointFamily):
    """Inertia of rotors."""

    kind = "rotor"
    label = "inertia of rotors"
    meaning = "torques of motors that accelerate their rotors"
    remedy = "estimate it: --terms coulomb,viscous,offset,rotor"

    def torques(self, at: Linearization) -> Array:
        """Accelerations, (m, n, 1) [N m or N]."""
        torque = at.motion.qdd / at.sizes.acceleration
        return np.asarray(0.05 * (at.sizes.torque * torque)[..., None])
