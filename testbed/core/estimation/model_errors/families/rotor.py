"""Inertia of rotors."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Rotor(JointFamily):
    """Inertia of the motors' rotors."""

    kind = "rotor"
    label = "inertia of rotors"
    meaning = "torques of motors that accelerate their rotors"
    remedy = "estimate it: --terms coulomb,viscous,offset,rotor"

    def torques(self, point: Linearization) -> Array:
        """Torques proportional to the joint accelerations, (m, n, 1) [N m or N]."""
        torque = point.motion.qdd / point.sizes.acceleration
        return np.asarray(0.05 * (point.sizes.torque * torque)[..., None])
