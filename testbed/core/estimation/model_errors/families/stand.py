"""Compliant base or table."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import FrameFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Stand(FrameFamily):
    """Compliant base or table."""

    kind = "stand"
    label = "a stand that gives way"
    meaning = "base or table move by the forces of the robot"
    remedy = "stiffen the stand, or bolt it to the floor; move more slowly"
    noisy = True

    def columns(self, point: Linearization) -> Array:
        """Effects of a base on springs in six directions, (m, C, 6) or (m, C, 12) [N, N m].

        The base is displaced in proportion to the quasi-static wrench on the robot, by 1 mm or mrad
        at the greatest force or moment. For the wrench method, six more columns describe a plate
        whose axes move with the base.
        """
        wrench = point.quasi_static_part(point.forces.wrench)
        largest = point.sizes.wrench.reshape(2, 3).max(axis=1)
        displacement = 1e-3 * wrench / np.repeat(largest, 3)
        change = point.displacement_effects(6 * point.tree.n, displacement[..., None])[
            ..., 0
        ]
        if point.method == "torque":
            return change
        return np.concatenate(
            [
                change,
                change - _transported_wrench_change(point.forces.wrench, displacement),
            ],
            axis=2,
        )


def _transported_wrench_change(wrench: Array, displacement: Array) -> Array:
    """Change of a wrench that is displaced rigidly with the base, (m, 6, 6).

    Args:
        wrench: Wrench, (m, 6) [N, N m].
        displacement: Displacements and rotations of the base, (m, 6) [m, rad].
    """
    force, moment = np.split(wrench, 2, axis=1)
    change = np.zeros((*displacement.shape, 6))
    for k, axis in enumerate(np.eye(3)):
        rotated = np.cross(axis, force)
        change[:, 3:, k] = rotated * displacement[:, k, None]
        change[:, :3, 3 + k] = rotated * displacement[:, 3 + k, None]
        change[:, 3:, 3 + k] = np.cross(axis, moment) * displacement[:, 3 + k, None]
    return change
