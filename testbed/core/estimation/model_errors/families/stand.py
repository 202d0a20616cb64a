"""A stand that gives way."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import FrameFamily
from testbed.core.estimation.model_errors.linearization import Linearization


class Stand(FrameFamily):
    """A stand that gives way."""

    kind = "stand"
    label = "a stand that gives way"
    meaning = "base or table move by the forces of the robot"
    remedy = "stiffen the stand, or bolt it to the floor; move more slowly"
    noisy = True

    def columns(self, at: Linearization) -> Array:
        """Effects of a base on springs, in fixed axes and in its own, (m, C, 6) or (m, C, 12)."""
        wrench = at.slow(at.forces.wrench)
        largest = at.sizes.wrench.reshape(2, 3).max(axis=1)
        moved = 1e-3 * wrench / np.repeat(largest, 3)
        change = at.displaced(6 * at.tree.n, moved[..., None])[..., 0]
        if at.method == "internal":
            return change
        return np.concatenate(
            [change, change - _carried(at.forces.wrench, moved)], axis=2
        )


def _carried(wrench: Array, moved: Array) -> Array:
    """Change of a wrench that moves with the base, (m, 6, 6).

    Args:
        wrench: (m, 6) [N, N m].
        moved: Slides and turns of the base, (m, 6) [m, rad].
    """
    force, moment = np.split(wrench, 2, axis=1)
    change = np.zeros((*moved.shape, 6))
    for k, axis in enumerate(np.eye(3)):
        turned = np.cross(axis, force)
        change[:, 3:, k] = turned * moved[:, k, None]
        change[:, :3, 3 + k] = turned * moved[:, 3 + k, None]
        change[:, 3:, 3 + k] = np.cross(axis, moment) * moved[:, 3 + k, None]
    return change
