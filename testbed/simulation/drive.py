"""The robot's own controller: torques that follow a reference, as a real drive would."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.dynamics import joint_forces
from testbed.dynamics.motion import Motion
from testbed.tree.tree import Tree


@dataclass(frozen=True, eq=False)
class Drive:
    """Proportional and derivative gains about a modelled torque, within the effort limits.

    Attributes:
        stiffness: (n,) [N m/rad or N/m].
        damping: (n,) [N m s/rad or N s/m].
        effort: Limits of the motors, (n,) [N m or N].
    """

    stiffness: Array
    damping: Array
    effort: Array

    def torque(self, modelled: Array, position_error: Array, velocity_error: Array) -> Array:
        """Motor torques for one sample, (n,) [N m or N]."""
        wanted = modelled + self.stiffness * position_error + self.damping * velocity_error
        limited: Array = np.clip(wanted, -self.effort, self.effort)
        return limited


def tuned_drive(tree: Tree, postures: Array, bandwidth: float) -> Drive:
    """A drive whose joints, each alone, answer with the given bandwidth where heaviest.

    Args:
        tree: The robot, its inertias an a-priori model.
        postures: Some postures of the motion to be followed, (k, n) [rad or m].
        bandwidth: [rad/s].
    """
    k, n = postures.shape
    pushes = np.tile(np.eye(n), (k, 1))  # each joint alone, in every posture
    still = np.zeros((k * n, n))
    motion = Motion(np.arange(k * n, dtype=float), postures.repeat(n, axis=0), still, pushes)
    mass_matrix = joint_forces(tree, motion, gravity=np.zeros(3)).reshape(k, n, n)
    inertia = mass_matrix.diagonal(axis1=1, axis2=2).max(axis=0)
    inertia = inertia + [joint.rotor_inertia for joint in tree.joints]
    effort = np.array([joint.max_effort for joint in tree.joints])
    return Drive(bandwidth**2 * inertia, 1.8 * bandwidth * inertia, effort)
