"""Encoders whose zero, scale or time is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.sensor.estimates import Effect, Nuisance, Numbers, Part
from testbed.core.estimation.sensor.predicted_wrench import Change, PredictedWrench


def _of_joints(kind: str, turning: str, sliding: str) -> Numbers:
    """A number of every joint, by the units of revolute and of prismatic ones."""
    return lambda tree: tuple(
        Part(f"{kind}/{joint.name}", turning if joint.revolute else sliding)
        for joint in tree.joints
    )


def _shown(*errors: Change, turning: bool = False) -> Effect:
    """Effect of what the encoders of all joints, or of revolute ones, show too much."""

    def columns(predicted: PredictedWrench) -> Array:
        joints = [
            j for j, joint in enumerate(predicted.tree.joints) if joint.revolute or not turning
        ]
        each = [-predicted.along(joint, error) for joint in joints for error in errors]
        none = np.zeros((predicted.motion.samples, 6, 0))
        return predicted.rows(np.stack(each, axis=2) if each else none)

    return columns


def _wave(value: Callable[[Array], Array], slope: Callable[[Array], Array]) -> Change:
    """A sine or cosine of the angle, and how it changes with the motion."""
    return lambda q, qd, qdd: (value(q), slope(q) * qd, slope(q) * qdd - value(q) * qd**2)


JOINT_ZEROS = Nuisance(
    "joint_zeros",
    _of_joints("joint_zeros", "rad", "m"),
    _shown(lambda q, qd, qdd: (1.0, 0.0, 0.0)),
    lambda recording, values, time, tree: replace(recording, position=recording.position - values),
    of_encoders=True,
    tested=True,
    unfolded=True,
)
"""What the encoders show too much."""

ENCODERS = (
    JOINT_ZEROS,
    # relative
    Nuisance(
        "encoder_gains",
        _of_joints("encoder_gains", "", ""),
        _shown(lambda q, qd, qdd: (q, qd, qdd)),
        of_encoders=True,
        tested=True,
    ),
    # by how much each is late; all of them by as much are a plate that is early
    Nuisance(
        "encoder_delays",
        _of_joints("encoder_delays", "s", "s"),
        lambda predicted: np.concatenate(
            [predicted.passing(j) for j in range(predicted.tree.n)], axis=2
        ),
        of_encoders=True,
        tested=True,
        covers=("skew",),
    ),
    # what repeats with every turn
    Nuisance(
        "eccentricity",
        lambda tree: tuple(
            Part(f"eccentricity/{joint.name}/{wave}", "rad")
            for joint in tree.joints
            if joint.revolute
            for wave in ("sin", "cos")
        ),
        _shown(_wave(np.sin, np.cos), _wave(np.cos, lambda q: -np.sin(q)), turning=True),
        of_encoders=True,
        tested=True,
    ),
)
"""Errors of encoders."""
