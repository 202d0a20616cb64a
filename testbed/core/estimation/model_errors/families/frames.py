"""Frames of the joints that are not those of the model file."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import FrameFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Frames(FrameFamily):
    """Frames of the joints that are not those of the model file."""

    kind = "frames"
    label = "joint frames that are not those of the file"
    meaning = "a kinematic model that differs from the robot by tenths of millimetres or degrees"
    remedy = "calibrate the kinematics, and use that model file"

    def columns(self, at: Linearization) -> Array:
        """Displacements by 0.5 mm and turns by 0.2 degrees before each joint, (m, C, 5 n)."""
        n = at.tree.n
        size = np.tile([5e-4] * 3 + [np.deg2rad(0.2)] * 2, n)
        return np.asarray(at.slopes.position[:, :, n : 6 * n] * size)
