"""Locking of joints that are missing or at rest in a recording; column removal."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import RecordingError, shortened_list
from testbed.core.recordings.columns import MIN_MOTION_RANGE
from testbed.core.recordings.source import Source
from testbed.core.recordings.views import joint_recording, transform_source
from testbed.core.robot.model_file import ModelFile, joint_names

MAX_SAMPLES = 100_000
"""Largest number of samples that are read at once."""


def hold_still(
    file: ModelFile, source: Source, *, lock_only: bool = False
) -> tuple[ModelFile, Source, tuple[Diagnostic, ...]]:
    """Lock the joints that do not move in a recording, and remove their columns.

    A joint that the file locks without a position is locked at the recorded mean. A joint at rest
    in the whole recording (range below `MIN_MOTION_RANGE`) is locked too, unless all joints are at
    rest, because its parameters are identifiable only in combination with those of the carrying
    body. Joints missing from the recording are locked as in `lock_unrecorded_joints`.

    Args:
        file: The model file; its lock may name recorded joints.
        source: The recording.
        lock_only: True to lock only joints that the file locks, not other joints at rest.

    Returns:
        The file with its locked joints, the recording without these joints, and diagnostics of
        joints that were locked without request.

    Raises:
        RecordingError: At some sample, a locked joint is more than 0.01 rad or m from its position.
    """
    file, lock_diagnostics = lock_unrecorded_joints(file, source)
    locked_file, reduced, diagnostics = lock_resting_joints(
        file, source, lock_only=lock_only
    )
    return locked_file, reduced, (*lock_diagnostics, *diagnostics)


def lock_resting_joints(
    file: ModelFile, source: Source, *, lock_only: bool = False
) -> tuple[ModelFile, Source, tuple[Diagnostic, ...]]:
    """Lock recorded joints that are locked in the file or at rest; remove their columns.

    Arguments, results and errors are those of `hold_still`. Joints at rest are locked at the
    recorded mean, limited to the joint's range of positions, and are listed in the diagnostic
    position.held.
    """
    diagnostics: tuple[Diagnostic, ...] = ()
    requested = [name for name in file.lock if name in source.names]
    if lock_only and not requested:
        return file, source, diagnostics
    low, high, mean = _position_ranges(source)
    positions = {}
    for name in requested:
        k, lock_position = source.names.index(name), file.lock[name]
        position = float(mean[k]) if lock_position is None else lock_position
        # largest deviation of a resting joint from the position in the lock [rad or m]
        if max(high[k] - position, position - low[k]) > 0.01:
            raise RecordingError(
                f"joint '{name}' is to be held at {position:.4g}, and the recording has it at "
                f"{low[k]:.4g} to {high[k]:.4g}"
            )
        positions[name] = position
    is_resting = high - low < MIN_MOTION_RANGE
    if not (lock_only or is_resting.all()):
        tree, names = file.tree(), np.array(source.names)[is_resting].tolist()
        resting = [
            name for name in names if name in tree.names and name not in file.lock
        ]
        for name in resting:
            least, greatest = tree.joints[tree.index(name)].position_range
            positions[name] = float(
                np.clip(mean[source.names.index(name)], least, greatest)
            )
        where = shortened_list([f"{name} at {positions[name]:.4g}" for name in resting])
        diagnostics += (make_diagnostic("position.held", where),) if resting else ()
    locked_file = replace(file, lock={**file.lock, **positions})
    return locked_file, without_joints(source, positions), diagnostics


def lock_unrecorded_joints(
    file: ModelFile, source: Source
) -> tuple[ModelFile, tuple[Diagnostic, ...]]:
    """Lock joints that a recording lacks, at positions from the mapping or at rest.

    Joints that the model file locks keep their positions. Other joints get the position in the
    `lock` table of the recording's mapping file or, if missing there, their rest position. If the
    recording has no joint of the model file, it belongs to another robot, and no joint is locked.

    Args:
        file: The model file.
        source: The recording.

    Returns:
        The file with its locked joints, and a diagnostic that lists them.

    Raises:
        ModelError: The file cannot be read.
    """
    names = joint_names(file.path)
    missing = [
        name for name in names if name not in source.names and name not in file.lock
    ]
    if not missing or len(missing) == len(names):
        return file, ()
    mapped_positions = (source.metadata.mapping or {}).get("lock", {})
    lock = {**{name: mapped_positions.get(name) for name in missing}, **file.lock}
    where = shortened_list(
        [f"{n} at {'rest' if lock[n] is None else f'{lock[n]:.4g}'}" for n in missing]
    )
    return replace(file, lock=lock), (
        make_diagnostic("robot.locked", where, len(missing)),
    )


def without_joints(source: Source, names: Collection[str]) -> Source:
    """Remove the columns of some joints from a recording, together with its true signals.

    Args:
        source: The recording; returned unchanged if it has none of the joints.
        names: Names of the joints to remove.
    """
    remaining = tuple(name for name in source.names if name not in names)
    if remaining == tuple(source.names):
        return source
    return transform_source(
        source,
        lambda recording: replace(joint_recording(recording, remaining), truth=None),
    )


def _position_ranges(source: Source) -> tuple[Array, Array, Array]:
    """Smallest, largest and mean position of each joint, (n,) each [rad or m]."""
    lows, highs, sums, count = [], [], [], 0
    for begin, end in source.segments:
        for first in range(begin, end, MAX_SAMPLES):
            position = source.part(first, min(end, first + MAX_SAMPLES)).position
            lows.append(position.min(axis=0))
            highs.append(position.max(axis=0))
            sums.append(position.sum(axis=0))
            count += len(position)
    return np.min(lows, axis=0), np.max(highs, axis=0), np.sum(sums, axis=0) / count
