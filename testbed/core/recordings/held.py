"""Joints that a recording lacks or does not move: held, their columns left out."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import RecordingError, few
from testbed.core.recordings.columns import STILL
from testbed.core.recordings.source import Source
from testbed.core.recordings.views import of_joints, transformed
from testbed.core.robot.model_file import ModelFile, joint_names

BLOCK = 100_000
"""Samples that are read at once."""


def hold_still(
    file: ModelFile, source: Source, *, lock_only: bool = False
) -> tuple[ModelFile, Source, tuple[Diagnostic, ...]]:
    """A robot with the joints held that a recording does not move, and the recording without them.

    A joint of the file's lock without a position is held at the recording's mean. A joint that
    rests in the whole recording is held as well, unless all do: of its parameters only
    combinations with those of the body that carries it are identifiable. Joints that the
    recording lacks are held as of `lock_unrecorded`.

    Args:
        file: The model file; its lock may name joints that the recording has.
        source: The recording.
        lock_only: Whether joints that are not in the lock stay free.

    Returns:
        The file with its lock, the recording, and which joints are held without being asked.

    Raises:
        RecordingError: The recording moves a joint that is to be held, or has it elsewhere.
    """
    file, locked = lock_unrecorded(file, source)
    found, fewer, said = hold_resting(file, source, lock_only=lock_only)
    return found, fewer, (*locked, *said)


def hold_resting(
    file: ModelFile, source: Source, *, lock_only: bool = False
) -> tuple[ModelFile, Source, tuple[Diagnostic, ...]]:
    """Model file with recorded joints held that are locked or rest; arguments of `hold_still`."""
    said: tuple[Diagnostic, ...] = ()
    asked = [name for name in file.lock if name in source.names]
    if lock_only and not asked:
        return file, source, said
    low, high, mean = _ranges(source)
    places = {}
    for name in asked:
        k, wanted = source.names.index(name), file.lock[name]
        place = float(mean[k]) if wanted is None else wanted
        # by how much a joint may rest beside where it is held [rad or m]
        if max(high[k] - place, place - low[k]) > 0.01:
            raise RecordingError(
                f"joint '{name}' is to be held at {place:.4g}, and the recording has it at "
                f"{low[k]:.4g} to {high[k]:.4g}"
            )
        places[name] = place
    still = high - low < STILL
    if not (lock_only or still.all()):
        tree, names = file.tree(), np.array(source.names)[still].tolist()
        resting = [
            name for name in names if name in tree.names and name not in file.lock
        ]
        for name in resting:
            least, most = tree.joints[tree.index(name)].position_range
            places[name] = float(np.clip(mean[source.names.index(name)], least, most))
        where = few([f"{name} at {places[name]:.4g}" for name in resting])
        said += (diagnose("position.held", where),) if resting else ()
    found = replace(file, lock={**file.lock, **places})
    return found, without(source, places), said


def lock_unrecorded(
    file: ModelFile, source: Source
) -> tuple[ModelFile, tuple[Diagnostic, ...]]:
    """Model file with unrecorded joints held, at the mapping's positions or at rest.

    Args:
        file: The model file.
        source: The recording; one that has none of the file's joints is of another robot.

    Returns:
        The file with its lock, and which joints were added to it.

    Raises:
        ModelError: The file cannot be read.
    """
    names = joint_names(file.path)
    lacking = [
        name for name in names if name not in source.names and name not in file.lock
    ]
    if not lacking or len(lacking) == len(names):
        return file, ()
    given = (source.metadata.mapping or {}).get("lock", {})
    lock = {**{name: given.get(name) for name in lacking}, **file.lock}
    where = few(
        [f"{n} at {'rest' if lock[n] is None else f'{lock[n]:.4g}'}" for n in lacking]
    )
    return replace(file, lock=lock), (diagnose("robot.locked", where, len(lacking)),)


def without(source: Source, names: Collection[str]) -> Source:
    """A recording without the columns of some joints, and without a truth if there are any.

    Args:
        source: The recording.
        names: Of joints; those that it does not have change nothing.
    """
    own = tuple(name for name in source.names if name not in names)
    if own == tuple(source.names):
        return source
    return transformed(source, lambda each: replace(of_joints(each, own), truth=None))


def _ranges(source: Source) -> tuple[Array, Array, Array]:
    """Least, greatest and mean position of each joint, (n,) each [rad or m]."""
    lows, highs, sums, count = [], [], [], 0
    for begin, end in source.segments:
        for first in range(begin, end, BLOCK):
            position = source.part(first, min(end, first + BLOCK)).position
            lows.append(position.min(axis=0))
            highs.append(position.max(axis=0))
            sums.append(position.sum(axis=0))
            count += len(position)
    return np.min(lows, axis=0), np.max(highs, axis=0), np.sum(sums, axis=0) / count
