"""Recordings seen otherwise: without coupled gears, from a base whose motion was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, overload

import numpy as np

from testbed.core.base.arrays import Array, apply
from testbed.core.base.errors import RecordingError
from testbed.core.dynamics.newton_euler import (
    Motion,
    joint_forces,
    pedestal_wrench,
    wrench_transforms,
)
from testbed.core.recordings.metadata import Metadata
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import DerivedSource, Source
from testbed.core.robot.free_base import COORDINATES, coordinates
from testbed.core.robot.shafts import Shafts, with_shafts
from testbed.core.robot.tree import Tree


def is_imported(source: Source) -> bool:
    """Whether a recording was made by a mapping file: real drives have offsets and couplings.

    Args:
        source: The recording.
    """
    return source.metadata.mapping is not None


def is_of_motors(source: Source) -> bool:
    """Whether some joint's torque was made of its motor's current, voltage or torque.

    Args:
        source: The recording.
    """
    return any(kind != "torque" for kind in source.metadata.effort.values())


def pedestal_said(source: Source) -> bool:
    """Whether a mapping says what of a plate's reading is the pedestal's, by its key.

    Args:
        source: The recording.
    """
    table = (source.metadata.mapping or {}).get("wrench")
    return isinstance(table, Mapping) and "pedestal" in table


def with_gear(tree: Tree, source: Source) -> Tree:
    """The robot with the shafts that a recording's gear couples, unless it has some already.

    Args:
        tree: The robot.
        source: The recording.
    """
    found = {} if tree.shafts else coupled_shafts(source.metadata.mapping or {})
    known = all(joint in tree.names for turns in found.values() for joint in turns)
    return with_shafts(tree, found) if found and known else tree


def coupled_shafts(mapping: Mapping[str, Any]) -> Shafts:
    """Shafts of the gear's rows with several joints, called JOINT.motor; {} where there are none.

    The shaft's own joint counts as one, or else the joint with which it turns most.

    Args:
        mapping: Of a recording; nothing in it is trusted.
    """
    try:
        joints = [str(joint) for joint in mapping["joints"]]
        rows = np.array(mapping["gear"]["matrix"], dtype=np.float64)
    except (LookupError, TypeError, ValueError, OverflowError):
        return {}
    if rows.shape != (len(joints), len(joints)) or not np.isfinite(rows).all():
        return {}
    found = {}
    for k, (name, row) in enumerate(zip(joints, rows, strict=True)):
        if np.count_nonzero(row) > 1:
            turns = row / (row[k] or row[np.argmax(np.abs(row))])
            coupled = np.flatnonzero(turns)
            found[f"{name}.motor"] = {joints[j]: float(turns[j]) for j in coupled}
    return found


NAMES = tuple(name for name, _, _ in COORDINATES)


class TransformedSource(DerivedSource):
    """A source whose parts are transformed one by one: other joints, no torques, no truth."""

    def __init__(
        self, source: Source, transform: Callable[[Recording], Recording]
    ) -> None:
        """The same samples.

        Args:
            source: The recording.
            transform: What is made of each part.
        """
        header = transform(source.part(0, min(1, source.samples)))
        super().__init__(header, source.samples, source.rate)
        self._source, self._transform, self.segments = (
            source,
            transform,
            source.segments,
        )

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1, without the truth.

        Raises:
            RecordingError: They cannot be seen so.
        """
        return self._transform(self._source.part(first, last))


def with_base_joints(recording: Recording) -> Recording:
    """A recording whose base is six joints.

    Args:
        recording: With a base.

    Raises:
        RecordingError: It has none, or a pose is none.
    """
    if recording.base is None:
        raise RecordingError(
            "the recording has no base/x ... base/qz, which a robot with robot.base = "
            '"measured" needs'
        )
    position = np.hstack([coordinates(recording.base), recording.position])
    return replace(
        recording,
        names=(*NAMES, *recording.names),
        position=position,
        base=None,
        torque=None,
        velocity=None,
        acceleration=None,
        temperature=None,
        truth=None,
        metadata=replace(recording.metadata, geometry={}),
    )


def of_joints(recording: Recording, names: Sequence[str]) -> Recording:
    """A recording of some of its joints, which is no longer checked as a whole robot's.

    Args:
        recording: With more.
        names: Of those that are kept, in the order of their columns.
    """
    metadata = replace(recording.metadata, geometry={})
    return replace(recording.of_joints(names), metadata=metadata)


def of_segment(recording: Recording, tree: Tree) -> Recording:
    """A recording of what lies between force sensors: the wrench of the bodies there alone.

    That of the first sensor, less those of the next, moved to its place; torques are of more.

    Args:
        recording: With the sensors' wrenches; its own wrench is the plate's, or that of the only
            sensor.
        tree: What lies between them, and the joints before.

    Raises:
        RecordingError: It lacks one of the joints, or of the sensors.
    """
    missing = [name for name in tree.names if name not in recording.names]
    if missing:
        raise RecordingError(
            f"the recording has no joint '{missing[0]}', which moves what the force sensor feels; "
            f"it has {', '.join(recording.names)}"
        )
    found = of_joints(recording, tree.names)
    own, gravity, truth = _segment_of(tree)[0], recording.metadata.gravity, found.truth
    whole = tree.sensor is None and all(cut.body >= 0 for cut in tree.cuts)
    tare = recording.tare if whole or own not in recording.sensor_names else None
    if recording.tare is not None and tare is None:
        tare = pedestal_wrench(tree, gravity)
    if truth is not None:
        true = _between(
            tree, truth.position, _wrenches(recording, truth.wrench, truth.sensors)
        )
        truth = None if true is None else replace(truth, wrench=true, sensors=None)
    shown = _wrenches(recording, recording.wrench, recording.sensors)
    return replace(
        found,
        wrench=_between(tree, found.position, shown),
        tare=tare,
        truth=truth,
        torque=None,
        temperature=None,
        sensors=None,
        sensor_names=(),
        metadata=replace(
            found.metadata,
            mapping=_mapping_of(found.metadata.mapping, own),
            segment=_segment_of(tree),
        ),
    )


def _mapping_of(
    mapping: Mapping[str, Any] | None, sensor: str
) -> Mapping[str, Any] | None:
    """Mapping with one sensor's wrench alone, if it names the sensor."""
    own = (mapping or {}).get("sensors", {}).get(sensor)
    if mapping is None or own is None:
        return mapping
    kept = {k: v for k, v in mapping.items() if k not in ("wrench", "plates")}
    return {**kept, "sensors": {sensor: own}}


def _segment_of(tree: Tree) -> tuple[str, ...]:
    """Name of the sensor, "" for the plate, and those of the next."""
    return (tree.sensor.name if tree.sensor else "", *(cut.name for cut in tree.cuts))


def _wrenches(
    recording: Recording, plate: Array | None, sensors: Array | None
) -> dict[str, Array]:
    """By sensor, the plate's called ""."""
    found = {} if plate is None else {"": plate}
    if sensors is not None:
        names = recording.sensor_names
        found |= {name: sensors[:, 6 * k : 6 * k + 6] for k, name in enumerate(names)}
    return found


def _between(
    tree: Tree, position: Array, wrenches: Mapping[str, Array]
) -> Array | None:
    """The first sensor's wrench less those of the next, (M, 6); None where it has none."""
    first, *following = _segment_of(tree)
    lacking = [name for name in following if name not in wrenches]
    if lacking:
        raise RecordingError(
            f"the recording has no wrench of the force sensor '{lacking[0]}'"
        )
    # a recording's only wrench is it
    alone = wrenches.get("") if len(wrenches) == 1 else None
    felt = wrenches.get(first, alone)
    if felt is None or not following:
        return felt
    moved = wrench_transforms(tree, position)
    beyond = np.sum([apply(moved[name], wrenches[name]) for name in following], axis=0)
    return np.asarray(felt - beyond)


@overload
def on_its_base(source: Recording, tree: Tree) -> Recording: ...


@overload
def on_its_base(source: Source, tree: Tree) -> Source: ...


def on_its_base(source: Source, tree: Tree) -> Source:
    """A source as a robot's: on a base that joints move, or whose pose was measured.

    Torques from which the model file's gravity was subtracted are those of the drives again.

    Args:
        source: The recording.
        tree: The robot.

    Raises:
        RecordingError: The recording lacks a joint of the robot, the base's pose, or a sensor.
    """
    if tree.floating and NAMES[0] not in source.names:
        source = transformed(source, with_base_joints)
    if tree.is_part and source.metadata.segment != _segment_of(tree):
        source = transformed(source, partial(of_segment, tree=tree))
    if "torque" in source.signals and _lacks_gravity(source.metadata):
        source = transformed(source, partial(with_gravity_torques, tree=tree))
    return source


def _lacks_gravity(metadata: Metadata) -> bool:
    """Whether a mapping says that the model file's gravity was subtracted from torques."""
    torque = (metadata.mapping or {}).get("torque")
    return isinstance(torque, Mapping) and torque.get("gravity") == "removed"


def with_gravity_torques(recording: Recording, tree: Tree) -> Recording:
    """A recording of torques to which those of the model file's gravity are added.

    Args:
        recording: With torques that its driver had compensated.
        tree: The robot as the driver knows it.
    """
    part = recording.ordered(tree)
    rest = Motion.at_rest(part.position)
    weight = joint_forces(tree, rest, part.metadata.gravity)
    mapping = dict(part.metadata.mapping or {})
    mapping["torque"] = {k: v for k, v in mapping["torque"].items() if k != "gravity"}
    return replace(
        part,
        torque=part.measured("torque") + weight,
        truth=None,
        metadata=replace(part.metadata, mapping=mapping),
    )


def transformed(source: Source, transform: Callable[[Recording], Recording]) -> Source:
    """A source of transformed recordings: at once of one in memory, else part by part.

    Args:
        source: The recording.
        transform: What is made of it.
    """
    if isinstance(source, Recording):
        return transform(source)
    return TransformedSource(source, transform)
