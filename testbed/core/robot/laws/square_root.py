"""Friction proportional to the square root of the speed."""

from __future__ import annotations

import numpy as np

from testbed.core.robot.joint_law import JointLaw

SQUARE_ROOT = JointLaw(
    "square_root",
    "N m s^.5/rad^.5",
    "N s^.5/m^.5",
    lambda qd, qdd: np.sign(qd) * np.sqrt(np.abs(qd)),
)
"""Friction proportional to the square root of the speed, as in lubricated gears."""
