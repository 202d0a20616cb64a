"""Viscous friction with different coefficients in the two directions of motion."""

from __future__ import annotations

import numpy as np

from testbed.core.robot.joint_law import JointLaw

ASYMMETRIC = JointLaw("asymmetric", "N m s/rad", "N s/m", lambda qd, qdd: np.abs(qd))
"""Difference of viscous friction between the two directions of motion.

A difference of Coulomb friction between the two directions is equivalent to a torque offset."""
