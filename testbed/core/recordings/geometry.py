"""Of which robot a recording is, and under which gravity: what it keeps, and the comparison."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.errors import RecordingError
from testbed.core.recordings.metadata import JointGeometry, Metadata, three
from testbed.core.robot.tree import Tree

TOLERANCE = 1e-9
"""Greatest difference of axes, offsets and rotations within one robot."""


class Described(Protocol):
    """What says of which robot it is."""

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names."""

    @property
    def metadata(self) -> Metadata:
        """As `Recording.metadata`."""


def geometry(tree: Tree) -> dict[str, JointGeometry]:
    """Geometry of the joints, by name."""
    parents = ["bedplate" if p < 0 else tree.names[p] for p in tree.parents]
    return {
        joint.name: JointGeometry(
            joint.kind,
            parent,
            three(joint.axis),
            three(joint.offset),
            (
                three(joint.rotation[0]),
                three(joint.rotation[1]),
                three(joint.rotation[2]),
            ),
        )
        for joint, parent in zip(tree.joints, parents, strict=True)
    }


def check_robot(recording: Described, tree: Tree) -> None:
    """Whether a recording is of this robot: joints by name, and their geometry if known.

    Raises:
        RecordingError: It is not.
    """
    if sorted(recording.names) != sorted(tree.names):
        raise RecordingError(
            f"the recording is of another robot: it has the joints {', '.join(recording.names)}, "
            f"the model has {', '.join(tree.names)}"
        )
    for name, joint in geometry(tree).items():
        known = asdict(recording.metadata.geometry.get(name, JointGeometry()))
        for what, value in asdict(joint).items():
            there = known[what]
            if there is not None and not _same(there, value):
                raise RecordingError(
                    f"the recording is of another robot: its joint '{name}' has {what} "
                    f"{json.dumps(there)}, the model has {json.dumps(value)}"
                )


def _same(there: Any, here: Any) -> bool:
    if isinstance(here, str):
        return bool(there == here)
    if np.shape(there) != np.shape(here):
        return False
    return bool(np.abs(np.subtract(there, here)).max() <= TOLERANCE)


def in_its_gravity(
    tree: Tree, source: Described, gravity: ArrayLike | None = None
) -> Tree:
    """The robot under the gravity that was given, or else the recording's, or the model file's.

    Args:
        tree: The robot.
        source: A recording; it may say its gravity.
        gravity: (3,) [m/s^2], bedplate frame, or None.
    """
    return tree.with_gravity(source.metadata.gravity if gravity is None else gravity)
