"""Friction that neighbouring joints hand on."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class CoupledFriction(JointFamily):
    """Friction and inertia of the drives before and behind a joint."""

    kind = "coupled_friction"
    label = "friction of a neighbouring drive"
    meaning = "drives that are coupled, as by differentials, belts or nested shafts"
    remedy = "state the coupling (robot.coupling): one shaft turns with several joints"
    is_term = True

    def applies(self, at: Linearization) -> bool:
        """Whether there is a neighbour."""
        return at.tree.n > 1

    def torques(self, at: Linearization) -> Array:
        """Sense, speed and acceleration of both neighbours, (m, n, 6) [N m or N]."""
        speed = at.motion.qd / at.sizes.speed
        acceleration = at.motion.qdd / at.sizes.acceleration
        each = np.stack([at.sense, speed, acceleration], axis=2)
        before, behind = np.zeros_like(each), np.zeros_like(each)
        for j, joint in enumerate(at.tree.joints):
            if joint.parent >= 0:
                before[:, j] = each[:, joint.parent]
                behind[:, joint.parent] = each[:, j]
        columns = np.concatenate([before, behind], axis=2)
        return np.asarray(0.02 * at.sizes.torque[:, None] * columns)
