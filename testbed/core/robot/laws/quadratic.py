"""Friction proportional to the square of the speed."""

from __future__ import annotations

import numpy as np

from testbed.core.robot.joint_law import JointLaw

QUADRATIC = JointLaw(
    "quadratic", "N m s^2/rad^2", "N s^2/m^2", lambda qd, qdd: qd * np.abs(qd)
)
"""Friction proportional to the square of the speed."""
