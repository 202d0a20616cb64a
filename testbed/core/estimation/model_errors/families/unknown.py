"""Smooth errors of unknown origin: random features of a Gaussian process."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily, ModelErrorFamily
from testbed.core.estimation.model_errors.linearization import Linearization

FEATURES = 12
"""Of each channel."""


def _features(state: Array, lengths: Array, count: int = FEATURES) -> Array:
    """Cosines of random combinations of a state, (m, count) of unit mean square together.

    Source    [RR07]

    Args:
        state: (m, k).
        lengths: Over which the error changes, (k,).
        count: Of features.
    """
    rng = np.random.default_rng(1996)
    directions = rng.normal(size=(state.shape[1], count)) / lengths[:, None]
    phases = rng.uniform(0, 2 * np.pi, count)
    return np.asarray(np.cos(state @ directions + phases) * np.sqrt(2 / count))


class UnknownJoint(JointFamily):
    """Unknown functions of each joint's position and speed."""

    kind = "unknown_joint"
    label = "an unknown torque by position and speed of the joint itself"
    meaning = "something in the drive that no law here describes"
    remedy = "plot residual against position and speed: `testbed view`"
    physical = False
    lasting = False

    def torques(self, at: Linearization) -> Array:
        """Features of position and relative speed, (m, n, 12) [N m or N]."""
        speed = at.motion.qd / at.sizes.speed
        states = np.stack([at.motion.q, speed], axis=2)
        each = [
            _features(states[:, j], np.array([0.4, 0.25])) for j in range(at.tree.n)
        ]
        return 0.03 * at.sizes.torque[:, None] * np.stack(each, axis=1)


class _UnknownChannels(ModelErrorFamily):
    """Unknown functions of a state in every channel."""

    physical = False
    lasting = False
    remedy = "repeat the motion in periods: what repeats is no noise (`testbed view` shows it)"

    def in_channels(self, at: Linearization, features: Array) -> Array:
        """Features, (m, k), in every channel, (m, C, C k)."""
        external = at.method == "external"
        size = at.sizes.wrench if external else at.sizes.torque
        columns = 0.03 * size[:, None, None] * np.eye(len(size))[..., None] * np.ones(1)
        return np.asarray(
            (columns * features[:, None, None]).reshape(len(features), len(size), -1)
        )


class UnknownPose(_UnknownChannels):
    """Unknown functions of the pose."""

    kind = "unknown_pose"
    label = "an unknown force by the pose"
    meaning = "something that depends on where the robot is"

    def columns(self, at: Linearization) -> Array:
        """Features of the positions, (m, C, 12 C)."""
        length = np.full(at.tree.n, 0.8 * np.sqrt(at.tree.n / 3))
        return self.in_channels(at, _features(at.motion.q, length))


class UnknownMotion(_UnknownChannels):
    """Unknown functions of positions, speeds and accelerations."""

    kind = "unknown_motion"
    label = "an unknown force by the motion"
    meaning = "something that depends on how the robot moves"

    def columns(self, at: Linearization) -> Array:
        """Features of the motion, (m, C, 12 C)."""
        motion, sizes, n = at.motion, at.sizes, at.tree.n
        state = [motion.q, motion.qd / sizes.speed, motion.qdd / sizes.acceleration]
        lengths = np.sqrt(n) * np.repeat([0.8, 0.5, 0.5], n)
        return self.in_channels(at, _features(np.concatenate(state, axis=1), lengths))


class UnknownTime(_UnknownChannels):
    """Unknown functions of time."""

    kind = "unknown_time"
    label = "an unknown force that changes in time"
    meaning = "a drift, or an event during the recording"
    methods = ("internal",)

    def columns(self, at: Linearization) -> Array:
        """Features of time, (m, C, 12 C)."""
        time = (at.time / at.sizes.duration)[:, None]
        return self.in_channels(at, _features(time, np.array([0.3])))
