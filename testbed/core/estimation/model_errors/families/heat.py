"""Friction that changes with time."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Heat(JointFamily):
    """Friction that changes with time."""

    kind = "heat"
    label = "friction that changes in time"
    meaning = "drives that warm up"
    remedy = "warm the robot up before the recording, or record temperatures"
    lasting = False
    is_term = True

    def torques(self, at: Linearization) -> Array:
        """Time, and its first two powers times both parts of friction, (m, n, 5) [N m or N]."""
        time = (at.time / at.sizes.duration)[:, None]
        speed = at.motion.qd / at.sizes.speed
        each = [time * np.ones_like(speed), time * at.sense, time * speed]
        each += [time**2 * at.sense, time**2 * speed]
        return 0.01 * at.sizes.torque[:, None] * np.stack(each, axis=2)
