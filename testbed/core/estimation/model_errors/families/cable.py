"""Cable or hose that pulls on a body."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import FrameFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Cable(FrameFamily):
    """Cable or hose that pulls on a body."""

    kind = "cable"
    label = "a cable or hose that pulls"
    meaning = "a dress pack or tether fastened beside the robot"
    remedy = "take it off, or guide it along the links; record once without it"

    def applies(self, point: Linearization) -> bool:
        """True if the base is fixed and the robot has several joints."""
        return super().applies(point) and point.tree.n > 1

    def columns(self, point: Linearization) -> Array:
        """Effects of forces at the origins of the bodies, (m, C, 4 (n - 1)) [N, N m].

        Each body after the first is subject to a constant force of 4 N along each axis of the
        bedplate, and to a spring of 8 N/m to the origin of the bedplate. Moments of the wrench are
        about this origin.
        """
        pulls = []
        for j in range(1, point.tree.n):
            origin = point.forces.origins[:, j]
            constant = np.broadcast_to(4 * np.eye(3)[:, None], (3, *origin.shape))
            for force in (*constant, -8 * origin):
                wrench = np.concatenate([force, np.cross(origin, force)], axis=1)
                if point.method == "torque":
                    wrench = point.forces.joint_torques_of_wrench(wrench, j)
                pulls.append(wrench)
        return np.stack(pulls, axis=2)
