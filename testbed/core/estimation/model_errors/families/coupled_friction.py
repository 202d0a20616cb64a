"""Friction transmitted by a coupling from neighbouring drives."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class CoupledFriction(JointFamily):
    """Friction and inertia of the drives before and after a joint."""

    kind = "coupled_friction"
    label = "friction of a neighbouring drive"
    meaning = "drives that are coupled, as by differentials, belts or nested shafts"
    remedy = "state the coupling (robot.coupling): one shaft turns with several joints"
    is_term = True

    def applies(self, point: Linearization) -> bool:
        """True if the robot has several joints."""
        return point.tree.n > 1

    def torques(self, point: Linearization) -> Array:
        """Sign of velocity, velocity and acceleration of adjacent joints, (m, n, 6) [N m or N].

        The three columns of the parent come first, then those of the last child. They are scaled by
        the greatest speed and acceleration and by 2 % of the joint's greatest torque.
        """
        speed = point.motion.qd / point.sizes.speed
        acceleration = point.motion.qdd / point.sizes.acceleration
        each = np.stack([point.smooth_sign, speed, acceleration], axis=2)
        before, behind = np.zeros_like(each), np.zeros_like(each)
        for j, joint in enumerate(point.tree.joints):
            if joint.parent >= 0:
                before[:, j] = each[:, joint.parent]
                behind[:, joint.parent] = each[:, j]
        columns = np.concatenate([before, behind], axis=2)
        return np.asarray(0.02 * point.sizes.torque[:, None] * columns)
