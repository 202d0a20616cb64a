"""Friction that changes with time, as drives warm up."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Heat(JointFamily):
    """Friction that changes with time, as drives warm up."""

    kind = "heat"
    label = "friction that changes in time"
    meaning = "drives that warm up"
    remedy = "warm the robot up before the recording, or record temperatures"
    lasting = False
    is_term = True

    def torques(self, point: Linearization) -> Array:
        """Time, and dry and viscous friction times time and time squared, (m, n, 5) [N m or N]."""
        time = (point.time / point.sizes.duration)[:, None]
        speed = point.motion.qd / point.sizes.speed
        each = [time * np.ones_like(speed), time * point.smooth_sign, time * speed]
        each += [time**2 * point.smooth_sign, time**2 * speed]
        return 0.01 * point.sizes.torque[:, None] * np.stack(each, axis=2)
