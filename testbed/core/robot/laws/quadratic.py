"""Friction in proportion to the square of the velocity."""

from __future__ import annotations

import numpy as np

from testbed.core.robot.joint_law import JointLaw

QUADRATIC = JointLaw(
    "quadratic", "N m s^2/rad^2", "N s^2/m^2", lambda qd, qdd: qd * np.abs(qd)
)
"""Friction in proportion to the square of the velocity."""
