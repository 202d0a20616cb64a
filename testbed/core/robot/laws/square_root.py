"""Friction in proportion to the root of the velocity."""

from __future__ import annotations

import numpy as np

from testbed.core.robot.joint_law import JointLaw

SQUARE_ROOT = JointLaw(
    "square_root",
    "N m s^.5/rad^.5",
    "N s^.5/m^.5",
    lambda qd, qdd: np.sign(qd) * np.sqrt(np.abs(qd)),
)
"""Friction in proportion to the root of the velocity: of lubricated gears."""
