"""Recordings seen otherwise: without coupled gears, from a base whose motion was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source, segments_of
from testbed.robot.free_base import COORDINATES, coordinates
from testbed.robot.locks import Shafts, with_shafts
from testbed.robot.tree import Tree

LONGEST = 1000
"""Joints of a mapping."""


def is_imported(source: Source) -> bool:
    """Whether a recording was made by a mapping file: real drives have offsets and couplings.

    Args:
        source: The recording.
    """
    return "mapping" in source.facts


def with_gear(tree: Tree, source: Source) -> Tree:
    """The robot with the shafts that a recording's gear couples, unless it has some already.

    Args:
        tree: The robot.
        source: The recording.
    """
    found = {} if tree.shafts else coupled_shafts(source.facts)
    known = all(joint in tree.names for turns in found.values() for joint in turns)
    return with_shafts(tree, found) if found and known else tree


def coupled_shafts(facts: Mapping[str, Any]) -> Shafts:
    """Shafts of the gear's rows with several joints, called JOINT.motor; {} where there are none.

    The shaft's own joint counts as one, or else the joint with which it turns most.

    Args:
        facts: Of a recording; nothing in it is trusted.
    """
    mapping = facts.get("mapping")
    gear = mapping.get("gear") if isinstance(mapping, Mapping) else None
    joints = mapping.get("joints") if isinstance(mapping, Mapping) else None
    rows = _rows(gear.get("matrix")) if isinstance(gear, Mapping) else None
    named = isinstance(joints, Sequence) and all(isinstance(joint, str) for joint in joints)
    if rows is None or not named or rows.shape != (len(joints or ()),) * 2:
        return {}
    found = {}
    for k, (name, row) in enumerate(zip(joints or (), rows, strict=True)):
        if np.count_nonzero(row) > 1:
            turns = row / (row[k] or row[np.argmax(np.abs(row))])
            found[f"{name}.motor"] = {
                joint: float(turn) for joint, turn in zip(joints or (), turns, strict=True) if turn
            }
    return found


def _rows(matrix: object) -> Any:
    try:
        rows = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    square = rows.ndim == 2 and rows.shape[0] == rows.shape[1] <= LONGEST
    return rows if square and np.isfinite(rows).all() else None


NAMES = tuple(name for name, _, _ in COORDINATES)


class MeasuredBase:
    """A source whose base is six joints; torques are none of the ground's and left out."""

    def __init__(self, source: Source) -> None:
        """The same samples.

        Args:
            source: With the signal `base`.

        Raises:
            RecordingError: It has none.
        """
        if "base" not in source.signals:
            raise RecordingError(
                "the recording has no base/x ... base/qz, which a robot with robot.base = "
                '"measured" needs'
            )
        self._source = source
        self.names = (*NAMES, *source.names)
        self.samples, self.rate, self.tare = source.samples, source.rate, source.tare
        self.facts = {k: v for k, v in source.facts.items() if k != "geometry"}
        self.signals = tuple(s for s in source.signals if s in ("time", "position", "wrench"))
        self.senses_kinematics = False

    names: tuple[str, ...]
    samples: int
    rate: float
    tare: Array | None
    facts: Mapping[str, Any]
    signals: tuple[str, ...]
    senses_kinematics: bool

    @property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """As `segments_of`."""
        return segments_of(self._source)

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1, without the truth.

        Raises:
            RecordingError: The base's pose is none there.
        """
        return with_base_joints(self._source.part(first, last))


def with_base_joints(recording: Recording) -> Recording:
    """A recording whose base is six joints.

    Args:
        recording: With a base.

    Raises:
        RecordingError: It has none, or a pose is none.
    """
    position = np.hstack([coordinates(recording.measured("base")), recording.position])
    return replace(
        recording,
        names=(*NAMES, *recording.names),
        position=position,
        base=None,
        torque=None,
        velocity=None,
        acceleration=None,
        truth=None,
        facts={k: v for k, v in recording.facts.items() if k != "geometry"},
    )


def on_its_base(source: Source, tree: Tree) -> Source:
    """A source as a robot's: where its base is free, with the base's coordinates.

    Args:
        source: The recording.
        tree: The robot.

    Raises:
        RecordingError: The base is free, and nothing is said of its pose.
    """
    if not tree.floating or NAMES[0] in source.names:
        return source
    return with_base_joints(source) if isinstance(source, Recording) else MeasuredBase(source)
