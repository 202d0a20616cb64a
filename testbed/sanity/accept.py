"""A recording held against its robot before anything is estimated: the room's front door."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
from testbed.sanity.search import Progress
from testbed.sanity.verdict import digest, kept_warnings, verdict

UNCHECKED = "the recording was not held against the robot (--unchecked)"

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


def accept(
    tree: Tree, source: Source, *, align: bool = False, unchecked: bool = False,
    progress: Progress | None = None,
) -> Acceptance:  # fmt: skip
    """Hold a recording against its robot; what was accepted and kept its verdict is not held again.

    Args:
        tree: The robot, its masses right within a factor of a few.
        source: The recording.
        align: Whether clocks are set right besides: a late plate does not stop then.
        unchecked: Whether to accept it without a search for what is wrong.
        progress: Told how much of the search is done.

    Raises:
        RecordingError: The recording cannot be true of this robot; says what would cure it.
    """
    source = on_its_base(source, tree)
    moved = [] if tree.floating else _moving_base(source)
    if moved and not unchecked:
        raise RecordingError(moved[0])
    said = [UNCHECKED]
    if not unchecked:
        known = kept_warnings(digest(tree, source), source)
        if known is not None:
            return Acceptance((), known)
        found = check_sanity(tree, source, progress)
        found.require(align=align)
        said = [each.text for each in found.likely]
    clocks = clock_offsets(tree, source)
    mapping = source.facts.get("mapping", {})
    late = [f"{each.text}; {cure(each, mapping)}" for each in clocks if each.late or each.drifts]
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
    path: Path, tree: Tree, *, align: bool = False, unchecked: bool = False,
    progress: Progress | None = None,
) -> tuple[tuple[Recording, ...], list[str], Acceptance]:  # fmt: skip
    """Recordings made by a mapping file, the longest of which is held against its robot.

    Args:
        path: The mapping file.
        tree: The robot, its masses right within a factor of a few.
        align: Whether delays and drifts of clocks that are found are taken back.
        unchecked: Whether to accept them without a search for what is wrong.
        progress: Told how much of the search is done.

    Returns:
        The recording, or its pieces where a source was silent for too long, with the verdict;
        where it was cut, in words; and what was found before anything was taken back.

    Raises:
        ExperimentError: The mapping is not understood.
        RecordingError: A file is damaged, or the recording cannot be true of this robot.
    """
    made, lines = pieces(path)
    longest = max(made, key=lambda each: each.samples)
    found = accept(tree, longest, align=align, unchecked=unchecked, progress=progress)
    if align:
        report = ImportReport.from_dict(longest.facts["import"])
        made, lines = pieces(path, aligned(read_mapping(path), report, found.clocks))
        found = Acceptance(found.clocks, _without_clocks(found.warnings))
    if not unchecked:
        made = tuple(_with_verdict(each, tree, found, made) for each in made)
    return made, lines, found


def _with_verdict(
    one: Recording, tree: Tree, found: Acceptance, pieces: Sequence[Recording]
) -> Recording:
    """A recording that keeps what was found of it, if it is the one that was looked at."""
    if one.samples < max(each.samples for each in pieces):
        return one
    of = digest(tree, on_its_base(one, tree))
    return replace(one, facts={**one.facts, **verdict(of, found.warnings)})


def _without_clocks(warnings: Sequence[str]) -> tuple[str, ...]:
    return tuple(line for line in warnings if not line.startswith("clock: "))
