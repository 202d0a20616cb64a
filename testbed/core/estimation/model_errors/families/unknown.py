"""Smooth errors of unknown origin: random Fourier features of a Gaussian process."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import JointFamily, ModelErrorFamily
from testbed.core.estimation.model_errors.linearization import Linearization

NUM_FEATURES = 12
"""Number of features in each channel."""


def _random_features(state: Array, lengths: Array, count: int = NUM_FEATURES) -> Array:
    """Random Fourier features of a state, (m, count), with unit sum of mean squares.

    Source    [RR07]

    Args:
        state: State variables, (m, k).
        lengths: Correlation lengths of the error, (k,).
        count: Number of features.
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

    def torques(self, point: Linearization) -> Array:
        """Random Fourier features of each joint's position and speed, (m, n, 12) [N m or N].

        Speeds are relative to `point.sizes.speed`; the features have 3 % of `point.sizes.torque`.
        """
        speed = point.motion.qd / point.sizes.speed
        states = np.stack([point.motion.q, speed], axis=2)
        each = [
            _random_features(states[:, j], np.array([0.4, 0.25]))
            for j in range(point.tree.n)
        ]
        return 0.03 * point.sizes.torque[:, None] * np.stack(each, axis=1)


class _UnknownChannels(ModelErrorFamily):
    """Unknown functions of a state in every channel."""

    physical = False
    lasting = False
    remedy = "repeat the motion in periods: what repeats is no noise (`testbed view` shows it)"

    def channel_columns(self, point: Linearization, features: Array) -> Array:
        """Features as separate columns of every channel, (m, C, C k) [N, N m].

        Args:
            point: Motion and predicted forces.
            features: Features, (m, k); a value of one corresponds to 3 % of the channel's greatest
                magnitude.
        """
        is_wrench = point.method == "wrench"
        size = point.sizes.wrench if is_wrench else point.sizes.torque
        columns = 0.03 * size[:, None, None] * np.eye(len(size))[..., None] * np.ones(1)
        return np.asarray(
            (columns * features[:, None, None]).reshape(len(features), len(size), -1)
        )


class UnknownPose(_UnknownChannels):
    """Unknown functions of the pose."""

    kind = "unknown_pose"
    label = "an unknown force by the pose"
    meaning = "something that depends on where the robot is"

    def columns(self, point: Linearization) -> Array:
        """Features of the joint positions in every channel, (m, C, 12 C)."""
        length = np.full(point.tree.n, 0.8 * np.sqrt(point.tree.n / 3))
        return self.channel_columns(point, _random_features(point.motion.q, length))


class UnknownMotion(_UnknownChannels):
    """Unknown functions of positions, speeds and accelerations."""

    kind = "unknown_motion"
    label = "an unknown force by the motion"
    meaning = "something that depends on how the robot moves"

    def columns(self, point: Linearization) -> Array:
        """Features of positions, speeds and accelerations in every channel, (m, C, 12 C)."""
        motion, sizes, n = point.motion, point.sizes, point.tree.n
        state = [motion.q, motion.qd / sizes.speed, motion.qdd / sizes.acceleration]
        lengths = np.sqrt(n) * np.repeat([0.8, 0.5, 0.5], n)
        return self.channel_columns(
            point, _random_features(np.concatenate(state, axis=1), lengths)
        )


class UnknownTime(_UnknownChannels):
    """Unknown functions of time."""

    kind = "unknown_time"
    label = "an unknown force that changes in time"
    meaning = "a drift, or an event during the recording"
    methods = ("torque",)

    def columns(self, point: Linearization) -> Array:
        """Features of time in every channel, (m, C, 12 C)."""
        time = (point.time / point.sizes.duration)[:, None]
        return self.channel_columns(point, _random_features(time, np.array([0.3])))
