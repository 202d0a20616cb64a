"""A recording held against its robot before anything is estimated: the room's front door."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.errors import RecordingError
from testbed.recordings.importing.import_report import ImportReport
from testbed.recordings.importing.mapping import read_mapping
from testbed.recordings.importing.pieces import pieces
from testbed.recordings.measured_base import on_its_base
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source
from testbed.robot.tree import Tree
from testbed.sanity.alignment import aligned, cure
from testbed.sanity.clock_offset import ClockOffset, clock_offsets
from testbed.sanity.sanity import MOST_SAMPLES, check_sanity

STILL = 5e-3
"""By how much a base that is welded may seem to move [m]."""


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
    source = on_its_base(source, tree)
    moved = [] if tree.floating else _moving_base(source)
    if moved and not unchecked:
        raise RecordingError(moved[0])
    found = check_sanity(tree, source)
    if not unchecked:
        found.require()
    clocks = clock_offsets(tree, source)
    mapping = source.facts.get("mapping", {})
    late = [f"{each.text}; {cure(each, mapping)}" for each in clocks if each.late or each.drifts]
    said = [each.text for each in (*found.certain, *found.likely)]
    return Acceptance(tuple(clocks), (*moved, *said, *late))


def _moving_base(source: Source) -> list[str]:
    """What is wrong where a base moves and the robot's is taken as welded."""
    if "base" not in source.signals:
        return []
    base = source.part(0, min(source.samples, MOST_SAMPLES)).measured("base")
    distance = float(np.linalg.norm(np.ptp(base[:, :3], axis=0)))
    if distance <= STILL:
        return []
    return [
        f"the recording's base moves by {distance:.2g} m, and the robot's is taken as welded to "
        "the bedplate: add --set robot.base=measured"
    ]


def accepted_import(
    path: Path, tree: Tree, *, align: bool = False, unchecked: bool = False
) -> tuple[tuple[Recording, ...], list[str], Acceptance]:
    """Recordings made by a mapping file, the longest of which is held against its robot.

    Args:
        path: The mapping file.
        tree: The robot, its masses right within a factor of a few.
        align: Whether delays and drifts of clocks that are found are taken back.
        unchecked: Whether what is certainly wrong is only warned of.

    Returns:
        The recording, or its pieces where a source was silent for too long; where it was cut, in
        words; and what was found before anything was taken back.

    Raises:
        ExperimentError: The mapping is not understood.
        RecordingError: A file is damaged, or the recording cannot be true of this robot.
    """
    made, lines = pieces(path)
    longest = max(made, key=lambda each: each.samples)
    found = accept(tree, longest, unchecked=unchecked)
    if not align:
        return made, lines, found
    report = ImportReport.from_dict(longest.facts["import"])
    again, lines = pieces(path, aligned(read_mapping(path), report, found.clocks))
    return again, lines, Acceptance(found.clocks, _without_clocks(found.warnings))


def _without_clocks(warnings: Sequence[str]) -> tuple[str, ...]:
    return tuple(line for line in warnings if not line.startswith("clock: "))
