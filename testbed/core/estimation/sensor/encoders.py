"""Encoders whose zero, scale or time is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.sensor.estimates import Nuisance, Numbers, Part, always
from testbed.core.estimation.sensor.predicted_wrench import Change, Number, PredictedWrench
from testbed.core.recordings.recording import Recording
from testbed.core.robot.tree import Tree


def _zeros(tree: Tree) -> tuple[Part, ...]:
    units = ("rad" if joint.revolute else "m" for joint in tree.joints)
    return tuple(Part(f"joint_zeros/{j}", u) for j, u in zip(tree.names, units, strict=True))


def _of_joints(kind: str, unit: str) -> Numbers:
    """A number of every joint, of one unit."""
    return lambda tree: tuple(Part(f"{kind}/{joint}", unit) for joint in tree.names)


def _waves(tree: Tree) -> tuple[Part, ...]:
    turning = [joint.name for joint in tree.joints if joint.revolute]
    return tuple(
        Part(f"eccentricity/{j}/{wave}", "rad") for j in turning for wave in ("sin", "cos")
    )


def _late(predicted: PredictedWrench) -> Array:
    return np.concatenate([predicted.passing(j) for j in range(predicted.tree.n)], axis=2)


def _hurried(predicted: PredictedWrench) -> Array:
    each = [predicted.along(j, _in_time) for j in range(predicted.tree.n)]
    return predicted.rows(-np.sum(each, axis=0)[..., None])


def _moved(predicted: PredictedWrench) -> Array:
    return _derivatives(predicted, [(j, _constant) for j in range(predicted.tree.n)])


def _scaled(predicted: PredictedWrench) -> Array:
    return _derivatives(predicted, [(j, _proportion) for j in range(predicted.tree.n)])


def _waved(predicted: PredictedWrench) -> Array:
    turning = [j for j, joint in enumerate(predicted.tree.joints) if joint.revolute]
    return _derivatives(predicted, [(j, wave) for j in turning for wave in (_sine, _cosine)])


def _derivatives(predicted: PredictedWrench, errors: Sequence[tuple[int, Change]]) -> Array:
    """The robot was where the encoders show it less their errors."""
    each = [-predicted.along(joint, change) for joint, change in errors]
    none = np.zeros((predicted.motion.samples, 6, 0))
    return predicted.rows(np.stack(each, axis=2) if each else none)


def _constant(q: Array, qd: Array, qdd: Array) -> tuple[Number, Number, Number]:
    del q, qd, qdd
    return 1.0, 0.0, 0.0


def _proportion(q: Array, qd: Array, qdd: Array) -> tuple[Number, Number, Number]:
    return q, qd, qdd


def _in_time(q: Array, qd: Array, qdd: Array) -> tuple[Number, Number, Number]:
    del q
    return 0.0, qd, 2 * qdd


def _sine(q: Array, qd: Array, qdd: Array) -> tuple[Number, Number, Number]:
    return np.sin(q), np.cos(q) * qd, np.cos(q) * qdd - np.sin(q) * qd**2


def _cosine(q: Array, qd: Array, qdd: Array) -> tuple[Number, Number, Number]:
    return np.cos(q), -np.sin(q) * qd, -np.sin(q) * qdd - np.cos(q) * qd**2


def _back(recording: Recording, values: Array, time: Array, tree: Tree) -> Recording:
    del time, tree
    return replace(recording, position=recording.position - values)


JOINT_ZEROS = Nuisance("joint_zeros", _zeros, _moved, _back, unfolded=True)
"""What the encoders show too much."""

ENCODER_GAINS = Nuisance(
    "encoder_gains",
    _of_joints("encoder_gains", ""),
    _scaled,
)
"""Relative."""

ECCENTRICITY = Nuisance(
    "eccentricity",
    _waves,
    _waved,
)
"""Errors that repeat with every turn."""

ENCODER_DELAYS = Nuisance(
    "encoder_delays",
    _of_joints("encoder_delays", "s"),
    _late,
    covers=("skew",),
)
"""By how much each is late; all of them by as much are a plate that is early."""

SAMPLING = Nuisance(
    "sampling",
    always(Part("sampling", "")),
    _hurried,
)
"""By how much more time passes between samples than their stamps say, relative."""
