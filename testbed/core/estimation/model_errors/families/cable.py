"""A cable or hose that pulls at a body."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import FrameFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Cable(FrameFamily):
    """A cable or hose that pulls at a body."""

    kind = "cable"
    label = "a cable or hose that pulls"
    meaning = "a dress pack or tether fastened beside the robot"
    remedy = "take it off, or guide it along the links; record once without it"

    def applies(self, at: Linearization) -> bool:
        """Whether the base is fixed, and a body moves on another."""
        return super().applies(at) and at.tree.n > 1

    def columns(self, at: Linearization) -> Array:
        """Constant pulls and springs at the origins of the bodies, (m, C, 4 (n - 1))."""
        pulls = []
        for j in range(1, at.tree.n):
            point = at.forces.origins[:, j]
            constant = np.broadcast_to(4 * np.eye(3)[:, None], (3, *point.shape))
            for force in (*constant, -8 * point):
                wrench = np.concatenate([force, np.cross(point, force)], axis=1)
                if at.method == "internal":
                    wrench = at.forces.torques_of(wrench, j)
                pulls.append(wrench)
        return np.stack(pulls, axis=2)
