"""Viscous friction that differs by direction."""

from __future__ import annotations

import numpy as np

from testbed.core.robot.joint_law import JointLaw

ASYMMETRIC = JointLaw("asymmetric", "N m s/rad", "N s/m", lambda qd, qdd: np.abs(qd))
"""Viscous friction that differs by direction; where dry friction does, an offset shows it."""
