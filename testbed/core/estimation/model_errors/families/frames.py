"""Joint frames that differ from the model file."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import FrameFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Frames(FrameFamily):
    """Joint frames that differ from the model file."""

    kind = "frames"
    label = "joint frames that are not those of the file"
    meaning = "a kinematic model that differs from the robot by tenths of millimetres or degrees"
    remedy = "calibrate the kinematics, and use that model file"

    def columns(self, point: Linearization) -> Array:
        """Effects of frame offsets and rotations, (m, C, 5 n) [N, N m].

        The errors before each joint are offsets of 0.5 mm along the three axes of the frame at zero
        joint positions, and rotations of 0.2 degrees about two axes normal to the joint axis.
        """
        n = point.tree.n
        size = np.tile([5e-4] * 3 + [np.deg2rad(0.2)] * 2, n)
        return np.asarray(point.slopes.position[:, :, n : 6 * n] * size)
