"""A mapping's recordings: one, or several where a source was silent for too long."""

from __future__ import annotations

from pathlib import Path

from testbed.diagnostics.diagnostic import Diagnostic
from testbed.recordings.checks import check_columns
from testbed.recordings.importing.convert import converted_pieces
from testbed.recordings.importing.mapping import Mapping, read_mapping
from testbed.recordings.recording import Recording


def pieces(
    path: Path, mapping: Mapping | None = None
) -> tuple[tuple[Recording, ...], list[Diagnostic]]:
    """The recordings that a mapping file makes, in the order of time, and where it was cut.

    Args:
        path: The mapping file.
        mapping: What it says; default what is in it.

    Raises:
        ExperimentError: The mapping is not understood.
        RecordingError: A file is missing or damaged, or does not hold what the mapping says.
    """
    found, said = converted_pieces(mapping or read_mapping(path), path.parent)
    made = [Recording.from_columns(each.columns, each.metadata, str(path)) for each in found]
    for recording in made:
        check_columns(recording.columns(), str(path))
    return tuple(made), said
