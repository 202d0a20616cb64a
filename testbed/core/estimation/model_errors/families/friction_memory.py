"""Friction that needs a way to change its sign after a reversal."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class FrictionMemory(JointFamily):
    """Friction that needs a way to change its sign after a reversal."""

    kind = "friction_memory"
    label = "friction with memory"
    meaning = "presliding: after a reversal the joint travels some milliradians before it slips"
    remedy = "move faster through reversals, or leave out more: identification.reversal_reach"
    is_term = True
    noisy = True

    def torques(self, at: Linearization) -> Array:
        """Dahl's friction over two travels less that of Coulomb, (m, n, 2) [N m or N]."""
        memories = [_lag(at, travel) for travel in (2e-3, 8e-3)]
        return 0.06 * at.sizes.torque[:, None] * np.stack(memories, axis=2)


def _lag(at: Linearization, travel: float) -> Array:
    """Dahl's friction of size one less its sign, (m, n).

    Args:
        at: Motion.
        travel: Over which a sign changes [rad or m].
    """
    qd, step = at.motion.qd, float(at.motion.t[1] - at.motion.t[0])
    sign, keep = np.sign(qd), np.exp(-np.abs(qd) * step / travel)
    force, lag = sign[0], np.zeros_like(qd)
    for k in range(len(qd)):
        force = sign[k] + (force - sign[k]) * keep[k]
        lag[k] = force - sign[k]
    return lag
