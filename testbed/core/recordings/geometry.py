"""Robot geometry and gravity of a recording, and their comparison with a model."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.errors import RecordingError
from testbed.core.recordings.metadata import JointGeometry, Metadata, vector_tuple
from testbed.core.robot.tree import Tree

GEOMETRY_TOLERANCE = 1e-9
"""Largest difference between axes, offsets [m] or rotation matrices that are considered equal."""


class DescribedSource(Protocol):
    """Protocol of a source with joint names and metadata, such as a recording."""

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names."""

    @property
    def metadata(self) -> Metadata:
        """Metadata, as in `Recording.metadata`."""


def joint_geometry(tree: Tree) -> dict[str, JointGeometry]:
    """Geometry of a robot's joints, keyed by joint name."""
    parents = ["bedplate" if p < 0 else tree.names[p] for p in tree.parents]
    return {
        joint.name: JointGeometry(
            joint.kind,
            parent,
            vector_tuple(joint.axis),
            vector_tuple(joint.offset),
            (
                vector_tuple(joint.rotation[0]),
                vector_tuple(joint.rotation[1]),
                vector_tuple(joint.rotation[2]),
            ),
        )
        for joint, parent in zip(tree.joints, parents, strict=True)
    }


def check_robot(recording: DescribedSource, tree: Tree) -> None:
    """Check that a recording belongs to a robot: joint names, and joint geometry if recorded.

    The order of the joint names does not matter. Axes, offsets and rotations must agree within
    GEOMETRY_TOLERANCE.

    Args:
        recording: Recording, or another source with joint names and metadata.
        tree: The robot.

    Raises:
        RecordingError: The joint names or the geometry differ.
    """
    if sorted(recording.names) != sorted(tree.names):
        raise RecordingError(
            f"the recording is of another robot: it has the joints {', '.join(recording.names)}, "
            f"the model has {', '.join(tree.names)}"
        )
    for name, joint in joint_geometry(tree).items():
        known = asdict(recording.metadata.geometry.get(name, JointGeometry()))
        for field, value in asdict(joint).items():
            recorded = known[field]
            if recorded is not None and not _is_equal(recorded, value):
                raise RecordingError(
                    f"the recording is of another robot: its joint '{name}' has {field} "
                    f"{json.dumps(recorded)}, the model has {json.dumps(value)}"
                )


def _is_equal(recorded: Any, value: Any) -> bool:
    """True if a recorded value equals the model's value (numbers within GEOMETRY_TOLERANCE)."""
    if isinstance(value, str):
        return bool(recorded == value)
    if np.shape(recorded) != np.shape(value):
        return False
    return bool(np.abs(np.subtract(recorded, value)).max() <= GEOMETRY_TOLERANCE)


def with_recorded_gravity(
    tree: Tree, source: DescribedSource, gravity: ArrayLike | None = None
) -> Tree:
    """Robot with the given gravity or, if it is None, with recorded gravity if available.

    Args:
        tree: The robot; its own gravity is kept if no other gravity is available.
        source: Recording whose metadata may contain the gravity.
        gravity: Gravity in the bedplate frame, (3,) [m/s^2], or None.
    """
    return tree.with_gravity(source.metadata.gravity if gravity is None else gravity)
