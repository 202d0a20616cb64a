"""Elastic joints."""

from __future__ import annotations

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import ModelErrorFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class ElasticJoint(ModelErrorFamily):
    """Elastic deflection of joints between encoder and link."""

    kind = "elastic_joint"
    label = "elastic joints"
    meaning = "gears or belts that give way between encoder and link"
    remedy = "move more slowly, or record encoders at the link side"
    noisy = True

    def columns(self, point: Linearization) -> Array:
        """Effects of joint deflections proportional to quasi-static torques, (m, C, n) [N, N m].

        The deflection is 2 mrad or mm at the greatest torque of the bodies, low-passed at
        QUASI_STATIC_CUTOFF.
        """
        deflection = (
            2e-3 * point.quasi_static_part(point.forces.torque) / point.sizes.torque
        )
        return point.encoder_effects(deflection[..., None])
