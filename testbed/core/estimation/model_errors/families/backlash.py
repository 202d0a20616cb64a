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

    def columns(self, point: Linearization) -> Array:
        """Effects of position errors with the sign of the quasi-static torque, (m, C, n) [N, N m].

        The errors are 0.5 mrad or mm. The torque is the low-passed torque of the bodies, below
        QUASI_STATIC_CUTOFF; the sign is smooth within 2 % of the greatest torque.
        """
        torque = point.quasi_static_part(point.forces.torque)
        side = np.tanh(torque / (0.02 * point.sizes.torque))
        return point.encoder_effects(5e-4 * point.quasi_static_part(side)[..., None])
