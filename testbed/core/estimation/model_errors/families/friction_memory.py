"""Presliding friction: hysteresis after a reversal of the velocity."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class FrictionMemory(JointFamily):
    """Presliding friction: hysteresis after a reversal of the velocity."""

    kind = "friction_memory"
    label = "friction with memory"
    meaning = "presliding: after a reversal the joint travels some milliradians before it slips"
    remedy = "move faster through reversals, or leave out more: identification.reversal_reach"
    is_term = True
    noisy = True

    def torques(self, point: Linearization) -> Array:
        """Dahl minus Coulomb friction for two presliding distances, (m, n, 2) [N m or N]."""
        memories = [_dahl_deviation(point, travel) for travel in (2e-3, 8e-3)]
        return 0.06 * point.sizes.torque[:, None] * np.stack(memories, axis=2)


def _dahl_deviation(point: Linearization, travel: float) -> Array:
    """Difference `f - sign(qd)` of Dahl friction f of unit amplitude and Coulomb friction, (m, n).

    Args:
        point: Motion.
        travel: Presliding distance [rad or m].
    """
    qd, step = point.motion.qd, float(point.motion.t[1] - point.motion.t[0])
    sign, decay = np.sign(qd), np.exp(-np.abs(qd) * step / travel)
    force, deviation = sign[0], np.zeros_like(qd)
    for k in range(len(qd)):
        force = sign[k] + (force - sign[k]) * decay[k]
        deviation[k] = force - sign[k]
    return deviation
