"""What a force sensor in the robot can measure, as a limit of motions."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion, base_wrench, pedestal_wrench
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.robot.tree import Tree
from testbed.motion.limits import ForceBounds, PlateRange, force_bounds
from testbed.motion.samples import Instants, SampledRows, Samples


class SensorTerm:
    """The ranges of a force sensor in the robot: a plate that moves, under the links beyond it.

    Attributes:
        labels: What each is a limit of, (k,).
    """

    def __init__(
        self, tree: Tree, beyond: Tree, ranges: PlateRange, margin: float, name: str = "plate"
    ) -> None:
        """Ready to be asked.

        Args:
            tree: The robot that moves.
            beyond: What the sensor feels, its inertias an a-priori model.
            ranges: Of its channels.
            margin: Share of each that may be used.
            name: Of the sensor.
        """
        self._beyond, self._joints = beyond, [tree.index(name) for name in beyond.names]
        labels, self._rows, most = ranges.rows(margin)
        self.labels = tuple(label.replace("plate", name) for label in labels)
        self._most = most - self._rows @ pedestal_wrench(beyond)
        self._sampled = SampledRows(beyond, minimal_set(beyond, "reaction"), self._joints)

    def values(self, samples: Instants) -> Array:
        """Shares less what is allowed, (k, G)."""
        q, qd, qdd = (each[:, self._joints] for each in (samples.q, samples.qd, samples.qdd))
        wrench = base_wrench(self._beyond, Motion(np.arange(float(len(q))), q, qd, qdd))
        return self._rows @ wrench.T - self._most[:, None]

    def slopes(self, samples: Samples) -> Array:
        """Derivatives, (k, 3 n, G)."""
        assert samples.stencil is not None, "derivatives were not asked for"
        looks = samples.stencil.around(samples.q, samples.qd, samples.qdd)
        wrench = self._sampled.model @ self._sampled.slots(*looks)
        seen = (self._rows @ wrench).reshape(len(self._rows), -1, len(samples.q))
        return np.asarray(np.matmul(samples.stencil.weights, seen))

    def curvatures(self, bounds: ForceBounds) -> Array:
        """Bounds of second derivatives by time, (k, W)."""
        felt = force_bounds(self._beyond, bounds.motion[:, self._joints])
        force, moment = (np.linalg.norm(part, axis=1) for part in np.hsplit(self._rows, 2))
        return np.outer(force, felt.force) + np.outer(moment, felt.moment)
