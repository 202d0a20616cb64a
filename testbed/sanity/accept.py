"""A recording held against its robot before anything is estimated: the room's front door."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from testbed.recordings.importing.convert import converted
from testbed.recordings.importing.import_report import ImportReport
from testbed.recordings.importing.mapping import read_mapping
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source
from testbed.robot.tree import Tree
from testbed.sanity.alignment import aligned, cure
from testbed.sanity.clock_offset import ClockOffset, clock_offsets
from testbed.sanity.sanity import check_sanity


@dataclass(frozen=True)
class Acceptance:
    """What was found when a recording was held against its robot.

    Attributes:
        clocks: How late torques and wrench are.
        warnings: What may be wrong.
    """

    clocks: tuple[ClockOffset, ...]
    warnings: tuple[str, ...]


def accept(tree: Tree, source: Source, *, unchecked: bool = False) -> Acceptance:
    """Hold a recording against its robot.

    Args:
        tree: The robot, its masses right within a factor of a few.
        source: The recording.
        unchecked: Whether what is certainly wrong becomes a warning, too.

    Raises:
        RecordingError: The recording cannot be true of this robot; says what would cure it.
    """
    found = check_sanity(tree, source)
    if not unchecked:
        found.require()
    clocks = clock_offsets(tree, source)
    mapping = source.facts.get("mapping", {})
    late = [f"{each.text}; {cure(each, mapping)}" for each in clocks if each.late or each.drifts]
    said = [each.text for each in (*found.certain, *found.likely)]
    return Acceptance(tuple(clocks), (*said, *late))


def accepted_import(
    path: Path, tree: Tree, *, align: bool = False, unchecked: bool = False
) -> tuple[Recording, Acceptance]:
    """A recording made by a mapping file, held against its robot.

    Args:
        path: The mapping file.
        tree: The robot, its masses right within a factor of a few.
        align: Whether delays and drifts of clocks that are found are taken back.
        unchecked: Whether what is certainly wrong is only warned of.

    Returns:
        The recording, and what was found in it before anything was taken back.

    Raises:
        ExperimentError: The mapping is not understood.
        RecordingError: A file is damaged, or the recording cannot be true of this robot.
    """
    recording = Recording.from_mapping(path)
    found = accept(tree, recording, unchecked=unchecked)
    if not align:
        return recording, found
    report = ImportReport.from_dict(recording.facts["import"])
    mapping = aligned(read_mapping(path), report, found.clocks)
    again = converted(mapping, path.parent)
    made = Recording.from_columns(again.columns, again.metadata, str(path))
    return made, Acceptance(found.clocks, _without_clocks(found.warnings))


def _without_clocks(warnings: Sequence[str]) -> tuple[str, ...]:
    return tuple(line for line in warnings if not line.startswith("clock: "))
