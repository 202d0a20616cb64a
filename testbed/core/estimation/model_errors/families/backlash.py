"""Backlash of gears."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import ModelErrorFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Backlash(ModelErrorFamily):
    """Backlash of gears."""

    kind = "backlash"
    label = "backlash"
    meaning = "play between encoder and link that the torque takes up"
    remedy = "move so that gravity keeps the gears on one side, or record encoders at the link side"
    noisy = True

    def columns(self, at: Linearization) -> Array:
        """Effects of play by the sign of slow torques, (m, C, n)."""
        torque = at.slow(at.forces.torque)
        side = np.tanh(torque / (0.02 * at.sizes.torque))
        return at.encoders(5e-4 * at.slow(side)[..., None])
