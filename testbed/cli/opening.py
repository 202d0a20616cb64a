"""Opening of recordings for commands, and correction by a plate's calibration."""

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
    """Raise RecordingError if a recording is given twice.

    The noise of the two copies would be treated as independent.

    Args:
        paths: Paths of recordings, or links to recordings.

    Raises:
        RecordingError: A recording is given twice.
    """
    places = [
        os.path.realpath(path) for path in paths
    ]  # does not fail for a link to itself
    for path, place in zip(paths, places, strict=True):
        if places.count(place) > 1:
            raise RecordingError(
                f"'{path}' is given more than once: its data would count as new"
            )


def open_recording(path: Path) -> Source:
    """Open a recording, or import the one that a mapping file describes.

    Args:
        path: Recording (Parquet), whose data stay in the file, or mapping file (.toml), whose log
            files are read into memory.

    Raises:
        RecordingError: The file is not a recording.
        ExperimentError: The mapping is invalid.
    """
    if path.suffix == ".toml":
        from testbed.importing.convert import import_recording

        return import_recording(path)
    from testbed.core.recordings.source import open_source

    return open_source(path)


def corrected_source(source: Source, tree: Tree, plate: Path | None) -> Source:
    """Recording whose wrench is corrected for the calibrated errors of the plate.

    Args:
        source: The recording.
        tree: The robot.
        plate: Calibration file of the plate; None to return the recording unchanged.
    """
    from testbed.applications.calibration import corrected
    from testbed.lab.experiment.plate_file import read_calibration

    return (
        source
        if plate is None
        else corrected(source, tree, read_calibration(plate, tree))
    )
