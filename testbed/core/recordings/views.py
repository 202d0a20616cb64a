"""Transformed recordings: base joints, parts between force sensors, gravity torques, gears."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, overload

import numpy as np

from testbed.core.base.arrays import Array, multiply_vectors
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
from testbed.core.robot.free_base import BASE_COORDINATES, base_coordinates
from testbed.core.robot.shafts import ShaftRatios, with_shafts
from testbed.core.robot.tree import Tree


def is_imported(source: Source) -> bool:
    """True if a recording was imported with a mapping file.

    An imported recording comes from a real robot, whose drives have offsets and couplings.

    Args:
        source: The recording.
    """
    return source.metadata.mapping is not None


def has_motor_torques(source: Source) -> bool:
    """True if a joint torque was computed from a motor current, voltage or torque.

    Args:
        source: The recording.
    """
    return any(kind != "torque" for kind in source.metadata.effort.values())


def states_pedestal_share(source: Source) -> bool:
    """True if the mapping file states the pedestal's share of the plate's wrench.

    Args:
        source: The recording.
    """
    table = (source.metadata.mapping or {}).get("wrench")
    return isinstance(table, Mapping) and "pedestal" in table


def with_gear_shafts(tree: Tree, source: Source) -> Tree:
    """Robot with the shafts of a recording's gear matrix (`coupled_shafts`).

    The robot is returned unchanged if it already has shafts, or lacks a joint of the gear matrix.

    Args:
        tree: The robot.
        source: The recording.
    """
    shafts = {} if tree.shafts else coupled_shafts(source.metadata.mapping or {})
    known = all(joint in tree.names for ratios in shafts.values() for joint in ratios)
    return with_shafts(tree, shafts) if shafts and known else tree


def coupled_shafts(mapping: Mapping[str, Any]) -> ShaftRatios:
    """Shafts from rows of the gear matrix that couple several joints, named JOINT.motor.

    A row is divided by the coefficient of the joint JOINT or, if this is zero, by the largest
    coefficient. The result is empty if there is no valid gear matrix.

    Args:
        mapping: Mapping of a recording, not yet checked.
    """
    try:
        joints = [str(joint) for joint in mapping["joints"]]
        rows = np.array(mapping["gear"]["matrix"], dtype=np.float64)
    except (LookupError, TypeError, ValueError, OverflowError):
        return {}
    if rows.shape != (len(joints), len(joints)) or not np.isfinite(rows).all():
        return {}
    shafts = {}
    for k, (name, row) in enumerate(zip(joints, rows, strict=True)):
        if np.count_nonzero(row) > 1:
            ratios = row / (row[k] or row[np.argmax(np.abs(row))])
            coupled = np.flatnonzero(ratios)
            shafts[f"{name}.motor"] = {joints[j]: float(ratios[j]) for j in coupled}
    return shafts


BASE_JOINTS = tuple(name for name, _, _ in BASE_COORDINATES)
"""Names of the six joints of a free base."""


class TransformedSource(DerivedSource):
    """Source whose parts are transformed one by one on reading."""

    def __init__(
        self, source: Source, transform: Callable[[Recording], Recording]
    ) -> None:
        """Wrap a source of the same samples.

        Args:
            source: The recording.
            transform: Transformation of each part.
        """
        header = transform(source.part(0, min(1, source.samples)))
        super().__init__(header, source.samples, source.rate)
        self._source, self._transform, self.segments = (
            source,
            transform,
            source.segments,
        )

    def part(self, first: int, last: int) -> Recording:
        """Transformed samples `first` to `last - 1`, without the true signals.

        Raises:
            RecordingError: The part cannot be transformed.
        """
        return self._transform(self._source.part(first, last))


def with_base_joints(recording: Recording) -> Recording:
    """Replace the measured base poses of a recording by positions of six joints.

    The joints x, y, z, yaw, pitch, roll [m, rad] come first. Torques, velocities, accelerations,
    temperatures, true signals and the geometry in the metadata are removed.

    Args:
        recording: Recording with base poses.

    Raises:
        RecordingError: The recording has no base poses, or a pose is invalid.
    """
    if recording.base is None:
        raise RecordingError(
            "the recording has no base/x ... base/qz, which a robot with robot.base = "
            '"measured" needs'
        )
    position = np.hstack([base_coordinates(recording.base), recording.position])
    return replace(
        recording,
        names=(*BASE_JOINTS, *recording.names),
        position=position,
        base=None,
        torque=None,
        velocity=None,
        acceleration=None,
        temperature=None,
        truth=None,
        metadata=replace(recording.metadata, geometry={}),
    )


def joint_recording(recording: Recording, names: Sequence[str]) -> Recording:
    """Recording of some joints, without the joint geometry in the metadata.

    Because the geometry is removed, the recording is not compared with the whole robot.

    Args:
        recording: Recording with these and other joints.
        names: Names of the joints, in the order of the new columns.
    """
    metadata = replace(recording.metadata, geometry={})
    return replace(recording.of_joints(names), metadata=metadata)


def segment_recording(recording: Recording, tree: Tree) -> Recording:
    """Recording of a robot's part between force sensors, with the wrench on this part.

    The wrench is that of the first sensor, minus the wrenches of the next sensors, transformed to
    the frame of the first sensor. Torques are removed, because they also move other bodies. The
    tare is kept if it belongs to the plate or to the only sensor; otherwise it is replaced by the
    model's static wrench of the pedestal.

    Args:
        recording: Recording with the wrenches of the sensors; `wrench` is that of the plate or of
            the only sensor.
        tree: Part of the robot between the sensors, with the joints before this part.

    Raises:
        RecordingError: The recording lacks a joint or a sensor.
    """
    missing = [name for name in tree.names if name not in recording.names]
    if missing:
        raise RecordingError(
            f"the recording has no joint '{missing[0]}', which moves what the force sensor feels; "
            f"it has {', '.join(recording.names)}"
        )
    selected = joint_recording(recording, tree.names)
    sensor, gravity, truth = (
        _segment_sensors(tree)[0],
        recording.metadata.gravity,
        selected.truth,
    )
    includes_pedestal = tree.sensor is None and all(cut.body >= 0 for cut in tree.cuts)
    tare = (
        recording.tare
        if includes_pedestal or sensor not in recording.sensor_names
        else None
    )
    if recording.tare is not None and tare is None:
        tare = pedestal_wrench(tree, gravity)
    if truth is not None:
        true_wrench = _segment_wrench(
            tree,
            truth.position,
            _wrenches_by_sensor(recording, truth.wrench, truth.sensors),
        )
        truth = (
            None
            if true_wrench is None
            else replace(truth, wrench=true_wrench, sensors=None)
        )
    wrenches = _wrenches_by_sensor(recording, recording.wrench, recording.sensors)
    return replace(
        selected,
        wrench=_segment_wrench(tree, selected.position, wrenches),
        tare=tare,
        truth=truth,
        torque=None,
        temperature=None,
        sensors=None,
        sensor_names=(),
        metadata=replace(
            selected.metadata,
            mapping=_sensor_mapping(selected.metadata.mapping, sensor),
            segment=_segment_sensors(tree),
        ),
    )


def _sensor_mapping(
    mapping: Mapping[str, Any] | None, sensor: str
) -> Mapping[str, Any] | None:
    """Mapping with the columns of a single sensor, without the columns of plates.

    The mapping is returned unchanged if it lacks the sensor.
    """
    columns = (mapping or {}).get("sensors", {}).get(sensor)
    if mapping is None or columns is None:
        return mapping
    other_keys = {k: v for k, v in mapping.items() if k not in ("wrench", "plates")}
    return {**other_keys, "sensors": {sensor: columns}}


def _segment_sensors(tree: Tree) -> tuple[str, ...]:
    """Names of a part's force sensor ("" for the plate) and of the next sensors."""
    return (tree.sensor.name if tree.sensor else "", *(cut.name for cut in tree.cuts))


def _wrenches_by_sensor(
    recording: Recording, plate: Array | None, sensors: Array | None
) -> dict[str, Array]:
    """Wrenches keyed by sensor name ("" for the plate), (M, 6) each."""
    wrenches = {} if plate is None else {"": plate}
    if sensors is not None:
        names = recording.sensor_names
        wrenches |= {
            name: sensors[:, 6 * k : 6 * k + 6] for k, name in enumerate(names)
        }
    return wrenches


def _segment_wrench(
    tree: Tree, position: Array, wrenches: Mapping[str, Array]
) -> Array | None:
    """Wrench of the first sensor minus the next sensors' wrenches, (M, 6).

    The result is in the frame of the first sensor; it is None if the first sensor has no wrench. If
    a recording has a single wrench, it is taken as the wrench of the first sensor.

    Args:
        tree: Part of the robot between the sensors.
        position: Joint positions, (M, n) [rad or m].
        wrenches: Wrenches keyed by sensor name, (M, 6) each [N, N m].

    Raises:
        RecordingError: One of the next sensors has no wrench.
    """
    sensor, *next_sensors = _segment_sensors(tree)
    missing = [name for name in next_sensors if name not in wrenches]
    if missing:
        raise RecordingError(
            f"the recording has no wrench of the force sensor '{missing[0]}'"
        )
    # the only wrench of a recording is of the first sensor
    only_wrench = wrenches.get("") if len(wrenches) == 1 else None
    wrench = wrenches.get(sensor, only_wrench)
    if wrench is None or not next_sensors:
        return wrench
    transforms = wrench_transforms(tree, position)
    subtracted = np.sum(
        [multiply_vectors(transforms[name], wrenches[name]) for name in next_sensors],
        axis=0,
    )
    return np.asarray(wrench - subtracted)


@overload
def adapt_to_robot(source: Recording, tree: Tree) -> Recording: ...


@overload
def adapt_to_robot(source: Source, tree: Tree) -> Source: ...


def adapt_to_robot(source: Source, tree: Tree) -> Source:
    """Transform a recording to match the base, force sensors and gravity of a robot.

    For a free base, measured base poses become joint positions. For a part of a robot between force
    sensors, the wrench becomes the wrench on this part. If gravity torques were subtracted (key
    torque.gravity = "removed" of the mapping file), they are added again. Otherwise, the recording
    is returned unchanged.

    Args:
        source: The recording.
        tree: The robot.

    Raises:
        RecordingError: The recording lacks a joint of the robot, the base poses, or a sensor.
    """
    if tree.floating and BASE_JOINTS[0] not in source.names:
        source = transform_source(source, with_base_joints)
    if tree.is_part and source.metadata.segment != _segment_sensors(tree):
        source = transform_source(source, partial(segment_recording, tree=tree))
    if "torque" in source.signals and _lacks_gravity(source.metadata):
        source = transform_source(source, partial(with_gravity_torques, tree=tree))
    return source


def _lacks_gravity(metadata: Metadata) -> bool:
    """True if gravity torques were subtracted from the torques, according to the mapping file."""
    torque = (metadata.mapping or {}).get("torque")
    return isinstance(torque, Mapping) and torque.get("gravity") == "removed"


def with_gravity_torques(recording: Recording, tree: Tree) -> Recording:
    """Add the gravity torques of the model file to the torques of a recording.

    The true signals are removed, and the mapping no longer states that gravity was removed.

    Args:
        recording: Recording with gravity-compensated torques; its gravity is used if known,
            otherwise that of the model.
        tree: Robot with the inertias that were used for the compensation.
    """
    ordered = recording.ordered(tree)
    motion = Motion.at_rest(ordered.position)
    gravity_torques = joint_forces(tree, motion, ordered.metadata.gravity)
    mapping = dict(ordered.metadata.mapping or {})
    mapping["torque"] = {k: v for k, v in mapping["torque"].items() if k != "gravity"}
    return replace(
        ordered,
        torque=ordered.measured("torque") + gravity_torques,
        truth=None,
        metadata=replace(ordered.metadata, mapping=mapping),
    )


def transform_source(
    source: Source, transform: Callable[[Recording], Recording]
) -> Source:
    """Transform a source, at once if it is in memory, otherwise part by part.

    Args:
        source: The recording.
        transform: Transformation of a recording.
    """
    if isinstance(source, Recording):
        return transform(source)
    return TransformedSource(source, transform)
