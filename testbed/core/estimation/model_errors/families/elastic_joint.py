"""Elastic joints."""

from __future__ import annotations

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import ModelErrorFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class ElasticJoint(ModelErrorFamily):
    """Elastic joints."""

    kind = "elastic_joint"
    label = "elastic joints"
    meaning = "gears or belts that give way between encoder and link"
    remedy = "move more slowly, or record encoders at the link side"
    noisy = True

    def columns(self, at: Linearization) -> Array:
        """Effects of deflections by slow torques, (m, C, n)."""
        deflection = 2e-3 * at.slow(at.forces.torque) / at.sizes.torque
        return at.encoders(deflection[..., None])
