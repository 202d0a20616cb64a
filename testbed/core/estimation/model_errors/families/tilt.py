"""A base that is not level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import FrameFamily
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.robot.tree import Tree


class BaseTilt(FrameFamily):
    """A base that is not level."""

    kind = "tilt"
    label = "a base that is not level"
    meaning = "gravity along another direction than stated"
    remedy = "level the base, or state gravity: --gravity"

    def numbers(self, tree: Tree) -> Sequence[tuple[str, str, float]]:
        """Turns about the bedplate's axes."""
        del tree
        return [(f"tilt/{axis}", "deg", 1.0) for axis in "xyz"]

    def columns(self, at: Linearization) -> Array:
        """Turns of the base by one degree, in the plate's own axes, (m, C, 3)."""
        turns = at.slopes.position[:, :, -3:]
        if at.method == "external":
            force, moment = np.split(at.forces.wrench, 2, axis=1)
            axes = np.eye(3)
            own = [np.cross(axes[:, None], each) for each in (force, moment)]
            turns = turns - np.concatenate(own, axis=2).transpose(1, 2, 0)
        return np.asarray(np.deg2rad(1.0) * turns)
