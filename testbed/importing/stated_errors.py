"""Sensor errors whose coefficients a mapping states, taken back."""

from __future__ import annotations

import numpy as np

from testbed.core.recordings.recording import Recording
from testbed.core.robot.inertia import NOTHING
from testbed.core.robot.tree import Joint, Tree
from testbed.importing.foreign_table import slides
from testbed.importing.mapping import Mapping
from testbed.sensors.catalogue import errors_of
from testbed.sensors.corrected import Corrected


def without_stated_errors(mapping: Mapping, recording: Recording) -> Recording:
    """Recording without the sensor errors of a mapping.

    Args:
        mapping: With coefficients in its table [errors].
        recording: With these errors.

    Raises:
        UnknownName: No sensor error has such a coefficient.
    """
    if not mapping.errors:
        return recording
    joints = names_as_tree(mapping)
    values = {
        error: np.array(own) for error, own in errors_of(joints, mapping.errors).items()
    }
    corrected = Corrected(recording, values, joints)
    return corrected.part(0, corrected.samples)


def names_as_tree(mapping: Mapping) -> Tree:
    """Joints of a mapping without geometry: names and kinds, by the units of the positions.

    Args:
        mapping: Of a recording.
    """
    units = mapping.position.units if mapping.position.matrix is None else []
    kinds = dict(zip(mapping.joints, map(slides, units), strict=False))
    z, origin, axes = np.eye(3)[2], np.zeros(3), np.eye(3)
    joints = tuple(
        Joint(
            name,
            name,
            "prismatic" if kinds.get(name) else "revolute",
            -1,
            z,
            origin,
            axes,
        )
        for name in mapping.joints
    )
    return Tree("", joints, (NOTHING,) * len(joints))
