"""Torque ripple of motors and gears."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Ripple(JointFamily):
    """Torque ripple of motors and gears."""

    kind = "ripple"
    label = "torque ripple"
    meaning = "a torque that repeats with the turn of motor or gear"
    remedy = "move the joint over many of its periods; the parameters hardly depend on it then"
    alternatives = 40

    def torques(self, point: Linearization) -> Array:
        """Sines and cosines of 40 multiples of the position, (m, n, 80) [N m or N]."""
        orders = np.arange(1, self.alternatives + 1)
        angle = point.motion.q[..., None] * orders
        waves = np.stack([np.sin(angle), np.cos(angle)], axis=3)
        waves = waves.reshape(*point.motion.q.shape, -1)
        return np.asarray(0.02 * point.sizes.torque[:, None] * waves)
