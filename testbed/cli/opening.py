"""Recordings of commands: opened from their files, corrected by a plate's calibration."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from testbed.core.base.errors import RecordingError

if TYPE_CHECKING:
    from testbed.core.recordings.source import Source
    from testbed.core.robot.tree import Tree


def require_different(paths: Sequence[Path]) -> None:
    """Refuse a recording that is given twice: its noise would count as another's.

    Args:
        paths: Recordings, links to them too.

    Raises:
        RecordingError: One is there twice.
    """
    places = [os.path.realpath(path) for path in paths]  # of a link to itself, too
    for path, place in zip(paths, places, strict=True):
        if places.count(place) > 1:
            raise RecordingError(
                f"'{path}' is given more than once: its data would count as new"
            )


def opened(path: Path) -> Source:
    """A recording that stays in its file, or one that a mapping file makes.

    Args:
        path: Parquet, or TOML for a mapping.

    Raises:
        RecordingError: It is no recording.
        ExperimentError: The mapping is not understood.
    """
    if path.suffix == ".toml":
        from testbed.importing.convert import import_recording

        return import_recording(path)
    from testbed.core.recordings.source import open_source

    return open_source(path)


def corrected_source(source: Source, tree: Tree, plate: Path | None) -> Source:
    """A recording as a perfect plate would have made it.

    Args:
        source: As it was made.
        tree: The robot.
        plate: The plate's file; None where it is taken as perfect.
    """
    from testbed.applications.calibration import corrected
    from testbed.lab.experiment.plate_file import read_plate

    return source if plate is None else corrected(source, tree, read_plate(plate, tree))
