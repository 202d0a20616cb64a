"""A recording held against its robot before anything is estimated: the room's front door.

The verdict is kept with the recording, so that nothing is held against a robot twice.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from testbed.diagnostics.diagnostic import Diagnosed, Diagnostic, diagnose, of_recording
from testbed.errors import RecordingError
from testbed.parameters.barycentric import standard
from testbed.recordings.geometry import geometry
from testbed.recordings.importing.mapping import Mapping
from testbed.recordings.importing.pieces import pieces
from testbed.recordings.measured_base import on_its_base
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source
from testbed.robot.tree import Tree
from testbed.sanity.assessment import MOST_SAMPLES, assess
from testbed.sanity.remedies import Line, in_mapping, with_lines
from testbed.sanity.search import Progress
from testbed.sanity.time_offset import TimeOffset, alignment, time_offsets
from testbed.toml_text import checked

RESTS = 5e-3
"""By how much a base that is welded may seem to move [m]."""

FACT = "verdict"
"""Where a recording keeps it."""

METHOD = 2
"""Of the check; another number and what was kept counts no more."""

BLOCK = 100_000
"""Samples that are read at once."""


@dataclass(frozen=True)
class CheckReport(Diagnosed):
    """What a recording held against its robot shows.

    Attributes:
        offsets: How late torques and wrench are.
        diagnostics: What may be wrong, what the data leave open, and signals that are late.
    """

    offsets: tuple[TimeOffset, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = ()


def check_recording(
    tree: Tree, source: Source, *, align: bool = False, unchecked: bool = False,
    progress: Progress | None = None,
) -> CheckReport:  # fmt: skip
    """Hold a recording against its robot; one that keeps a verdict is not held again.

    Args:
        tree: The robot, its masses right within a factor of a few.
        source: The recording.
        align: Whether clocks are set right besides: a late plate does not stop then.
        unchecked: Whether to accept it without a search for what is wrong.
        progress: Told how much of the search is done.

    Raises:
        RecordingError: The recording cannot be true of this robot; says what would make it right.
    """
    source = on_its_base(source, tree)
    doubts = [] if tree.floating else [*_base_motion(source)]
    if doubts and not unchecked:
        raise RecordingError(str(doubts[0]))
    if unchecked:
        doubts.append(diagnose("recording.unchecked"))
    else:
        verdict = source.facts.get(FACT) or {}
        if verdict.get("of") == digest(tree, source):
            return CheckReport(diagnostics=of_recording(verdict))
        assessment = assess(tree, source, progress)
        assessment.require(align=align)
        doubts += [each for each in assessment.diagnostics if each.level != "error"]
    rests = any(each.code == "robot.rest" for each in doubts)
    offsets = [] if rests else time_offsets(tree, source)  # without a motion there is no delay
    doubts += [
        each.diagnostic(f"{in_mapping(lines)}, or import with --model and --align")
        for each, lines in _alignments(offsets, source)
    ]
    return CheckReport(tuple(offsets), tuple(doubts))


def _base_motion(source: Source) -> Iterator[Diagnostic]:
    """What is wrong where a base moves and the robot's is taken as welded."""
    if "base" not in source.signals:
        return
    base = source.part(0, min(source.samples, MOST_SAMPLES)).measured("base")
    distance = float(np.linalg.norm(np.ptp(base[:, :3], axis=0)))
    if distance > RESTS:
        yield diagnose("recording.base-moves", "the base", distance)


def import_and_check(
    path: Path, tree: Tree, *, align: bool = False, unchecked: bool = False,
    progress: Progress | None = None,
) -> tuple[tuple[Recording, ...], list[Diagnostic], CheckReport]:  # fmt: skip
    """Recordings made by a mapping file, the longest of which is held against its robot.

    Args:
        path: The mapping file.
        tree: The robot, its masses right within a factor of a few.
        align: Whether delays and drifts of clocks are taken back.
        unchecked: Whether to accept them without a search for what is wrong.
        progress: Told how much of the search is done.

    Returns:
        The recording, or its pieces where a source was silent for too long, with the verdict;
        where it was cut; and what it shows before anything is taken back.

    Raises:
        ExperimentError: The mapping is not understood.
        RecordingError: A file is damaged, or the recording cannot be true of this robot.
    """
    recordings, cuts = pieces(path)
    longest = max(recordings, key=lambda each: each.samples)
    report = check_recording(tree, longest, align=align, unchecked=unchecked, progress=progress)
    if align:
        lines = chain.from_iterable(lines for _, lines in _alignments(report.offsets, longest))
        mapping = with_lines(longest.facts["mapping"], lines)
        recordings, cuts = pieces(path, checked(Mapping, mapping, str(path)))
        late = "recording.delay"  # was just taken back
        kept = tuple(each for each in report.diagnostics if each.code != late)
        report = replace(report, diagnostics=kept)
    if not unchecked:
        most = max(each.samples for each in recordings)
        recordings = tuple(
            _with_verdict(each, tree, report) if each.samples == most else each
            for each in recordings
        )
    return recordings, cuts, report


def _alignments(
    offsets: Sequence[TimeOffset], source: Source
) -> Iterator[tuple[TimeOffset, list[Line]]]:
    """Offsets that are no noise, and lines of the mapping that take them back."""
    mapping = source.facts.get("mapping", {})
    for each in offsets:
        if each.matters:
            yield each, [*alignment(each, mapping, source.facts)]


def _with_verdict(recording: Recording, tree: Tree, report: CheckReport) -> Recording:
    """A recording that keeps what was said of it."""
    of = digest(tree, on_its_base(recording, tree))
    verdict = {"of": of, "diagnostics": [each.as_dict() for each in report.diagnostics]}
    return replace(recording, facts={**recording.facts, FACT: verdict})


def digest(tree: Tree, source: Source) -> str:
    """Of all that a verdict depends on: the data, what the mapping says, the robot.

    Args:
        tree: The robot.
        source: The recording.
    """
    facts = [
        METHOD, source.names, source.rate, source.facts.get("mapping"),
        source.facts.get("gravity"), geometry(tree), standard(tree).tolist(),
        tree.gravity.tolist(), [joint.position_range.tolist() for joint in tree.joints],
        None if source.tare is None else source.tare.tolist(), tree.floating,
    ]  # fmt: skip
    sha = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    for first in range(0, source.samples, BLOCK):
        part = source.part(first, min(source.samples, first + BLOCK))
        for values in (part.time, part.position, part.torque, part.wrench):
            sha.update(b"" if values is None else values.tobytes())
    return sha.hexdigest()
