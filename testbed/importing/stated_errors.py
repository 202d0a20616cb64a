"""Removal of sensor errors whose coefficients are stated in a mapping."""

from __future__ import annotations

import numpy as np

from testbed.core.recordings.recording import Recording
from testbed.core.robot.inertia import ZERO_INERTIA
from testbed.core.robot.tree import Joint, Tree
from testbed.importing.foreign_table import is_length_unit
from testbed.importing.mapping import Mapping
from testbed.sensors.catalogue import coefficients_by_error
from testbed.sensors.corrected import CorrectedSource


def remove_stated_errors(mapping: Mapping, recording: Recording) -> Recording:
    """Recording without the sensor errors that a mapping states.

    Args:
        mapping: Mapping with coefficients in its table [errors].
        recording: Recording with these errors.

    Raises:
        UnknownName: A coefficient does not belong to any sensor error.
    """
    if not mapping.errors:
        return recording
    joints = tree_without_geometry(mapping)
    values = {
        error: np.array(coefficients)
        for error, coefficients in coefficients_by_error(joints, mapping.errors).items()
    }
    corrected = CorrectedSource(recording, values, joints)
    return corrected.part(0, corrected.samples)


def tree_without_geometry(mapping: Mapping) -> Tree:
    """Tree of a mapping's joints with names and kinds but without geometry.

    A joint is prismatic if the unit of its position is a length.

    Args:
        mapping: Content of the mapping file.
    """
    units = mapping.position.units if mapping.position.matrix is None else []
    kinds = dict(zip(mapping.joints, map(is_length_unit, units), strict=False))
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
    return Tree("", joints, (ZERO_INERTIA,) * len(joints))
