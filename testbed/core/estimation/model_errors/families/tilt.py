"""Base that is not level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import FrameFamily
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.robot.tree import Tree


class BaseTilt(FrameFamily):
    """Base that is not level."""

    kind = "tilt"
    label = "a base that is not level"
    meaning = "gravity along another direction than stated"
    remedy = "level the base, or state gravity: --gravity"

    def coefficient_scales(self, tree: Tree) -> Sequence[tuple[str, str, float]]:
        """Rotations about the axes of the bedplate, as coefficients to be reported."""
        del tree
        return [(f"tilt/{axis}", "deg", 1.0) for axis in "xyz"]

    def columns(self, point: Linearization) -> Array:
        """Effects of rotating the base by one degree, (m, C, 3) [N, N m].

        Rotations are about the bedplate's axes. For the wrench method, the plate turns with the
        base.
        """
        effects = point.slopes.position[:, :, -3:]
        if point.method == "wrench":
            force, moment = np.split(point.forces.wrench, 2, axis=1)
            axes = np.eye(3)
            rotated = [np.cross(axes[:, None], each) for each in (force, moment)]
            effects = effects - np.concatenate(rotated, axis=2).transpose(1, 2, 0)
        return np.asarray(np.deg2rad(1.0) * effects)
