"""Delay of the measured torques."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.robot.tree import Tree


class TorqueLag(JointFamily):
    """Delay of the measured torques."""

    kind = "torque_lag"
    label = "torques that are late"
    meaning = "a filter or a bus delays the torques"
    remedy = "state the delay where the log is imported ([torque] delay), or switch the filter off"

    def coefficient_scales(self, tree: Tree) -> Sequence[tuple[str, str, float]]:
        """Delays of the torques; negative if the positions are delayed."""
        return [(f"delay/{name}", "s", 0.005) for name in tree.names]

    def torques(self, point: Linearization) -> Array:
        """Change of the torques due to a delay of 5 ms, (m, n, 1) [N m or N]."""
        return np.asarray(-0.005 * point.time_derivative(point.total_torque)[..., None])
