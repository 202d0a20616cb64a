"""A plate that is turned or shifted against the bedplate frame.

The plate's frame has the origin p and the axes R = exp(r), both in the bedplate frame; it shows
R' F and R' (M - p x F), of robot and pedestal alike.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.arrays import Array
from testbed.identification.sensor.nuisance import Nuisance, Part, always
from testbed.identification.sensor.predicted_wrench import PredictedWrench
from testbed.recordings.recording import Recording
from testbed.robot.rotations import from_vector

_PARTS = tuple(Part(f"pose/r{a}", "rad") for a in "xyz") + tuple(
    Part(f"pose/p{a}", "m") for a in "xyz"
)


def _pose(predicted: PredictedWrench) -> Array:
    return predicted.rows(_moved(predicted.wrench))


def _pose_of_measured(predicted: PredictedWrench) -> Array:
    return _moved(predicted.shown)


def _moved(wrench: Array) -> Array:
    """By each of the six, (M, 6, 6)."""
    force, moment = wrench[:, :3], wrench[:, 3:]
    found = np.zeros((len(force), 6, 6))
    for k, axis in enumerate(np.eye(3)):
        found[:, :3, k] = -np.cross(axis, force)
        found[:, 3:, k] = -np.cross(axis, moment)
        found[:, 3:, 3 + k] = -np.cross(axis, force)
    return found


def _height(predicted: PredictedWrench) -> Array:
    return _pose(predicted)[..., 5:]


def _height_of_measured(predicted: PredictedWrench) -> Array:
    return _pose_of_measured(predicted)[..., 5:]


def _moved_back(recording: Recording, values: Array, time: Array) -> Recording:
    del time
    wrench = recording.measured("wrench")
    turn = from_vector(values[:3])
    force = wrench[:, :3] @ turn.T
    moment = wrench[:, 3:] @ turn.T + np.cross(values[3:], force)
    return replace(recording, wrench=np.hstack([force, moment]))


def _lowered(recording: Recording, values: Array, time: Array) -> Recording:
    return _moved_back(recording, np.array([0.0, 0.0, 0.0, 0.0, 0.0, values[0]]), time)


POSE = Nuisance(
    "pose",
    always(*_PARTS),
    _pose,
    _moved_back,
    by_measured=_pose_of_measured,
)

HEIGHT = Nuisance(
    "height",
    always(Part("height", "m")),
    _height,
    _lowered,
    by_measured=_height_of_measured,
)
"""The third component of the pose's shift alone."""
