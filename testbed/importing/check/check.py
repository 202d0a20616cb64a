"""A recording held against its robot before anything is estimated."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.base.diagnostics import (
    Diagnosed,
    Diagnostic,
    diagnose,
    from_json,
)
from testbed.core.base.errors import RecordingError
from testbed.core.base.toml_text import checked
from testbed.core.parameters.symbols import standard
from testbed.core.recordings.channels import channel_faults
from testbed.core.recordings.geometry import geometry
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.recordings.views import on_its_base
from testbed.core.robot.tree import Tree
from testbed.importing.check.assessment import MOST_SAMPLES, Assessment, assess
from testbed.importing.check.instants import middle
from testbed.importing.check.recording_diagnostics import (
    clocked,
    encoder_steps,
    unknown_gains,
)
from testbed.importing.check.remedies import with_lines
from testbed.importing.check.search import Progress
from testbed.importing.check.time_offset import TimeOffset, alignment, time_offsets
from testbed.importing.convert import pieces
from testbed.importing.import_report import in_mapping
from testbed.importing.mapping import Mapping

RESTS = 5e-3
"""By how much a base that is welded may seem to move [m]."""

METHOD = 4
"""Of the check; another number and what was kept counts no more."""


@dataclass(frozen=True)
class CheckReport(Diagnosed):
    """What a recording held against its robot shows.

    Attributes:
        offsets: How late torques and wrench are.
        diagnostics: What may be wrong, what the data leave open, and signals that are late.
    """

    offsets: tuple[TimeOffset, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True)
class Prepared:
    """Recordings that a mapping makes, and what is known of the longest of them.

    Attributes:
        recordings: In the order of time.
        cuts: Where a source was silent for too long.
        assessment: Of the longest; None where it was not assessed.
        offsets: How late its torques and its wrench are; None where that is not known.
    """

    recordings: tuple[Recording, ...]
    cuts: list[Diagnostic]
    assessment: Assessment | None = None
    offsets: Sequence[TimeOffset] | None = None

    @property
    def longest(self) -> Recording:
        """The recording of the most samples."""
        return max(self.recordings, key=lambda each: each.samples)


def check_recording(
    tree: Tree,
    source: Source,
    *,
    align: bool = False,
    unchecked: bool = False,
    progress: Progress | None = None,
    prepared: Prepared | None = None,
) -> CheckReport:
    """Hold a recording against its robot; one that keeps a verdict is not held again.

    Args:
        tree: The robot, its masses right within a factor of a few.
        source: The recording.
        align: Whether clocks are set right besides: a late plate does not stop then.
        unchecked: Whether to accept it without a search for what is wrong.
        progress: Called with how much of the search is done.
        prepared: What is known of the recording already.

    Raises:
        RecordingError: The recording cannot be true of this robot; says what would make it right.
    """
    source = on_its_base(source, tree)
    doubts = [] if tree.floating else [*_base_motion(source)]
    if doubts and not unchecked:
        raise RecordingError(str(doubts[0]))
    doubts += [*encoder_steps(source), *unknown_gains(source)]
    known = prepared or Prepared((), [])
    if unchecked:
        doubts.append(diagnose("recording.unchecked"))
        faults = channel_faults(source)
    else:
        verdict = source.metadata.verdict
        if verdict.get("of") == digest(tree, source):
            return CheckReport(diagnostics=from_json(verdict.get("diagnostics", [])))
        assessment = known.assessment or assess(tree, source, progress)
        assessment.require(align=align)
        doubts += [each for each in assessment.diagnostics if each.level != "error"]
        faults = assessment.faults
    offsets = known.offsets
    if any(each.code == "robot.rest" for each in doubts):
        offsets = ()  # without a motion there is no delay
    if offsets is None:
        offsets = time_offsets(tree, source, clocked(source, faults))
    for each in offsets:
        if each.matters:
            lines = in_mapping(_alignment([each], source))
            doubts.append(
                each.diagnostic(f"{lines}, or import with --model and --align")
            )
    return CheckReport(tuple(offsets), tuple(doubts))


def _base_motion(source: Source) -> Iterator[Diagnostic]:
    """What is wrong where a base moves and the robot's is taken as welded."""
    if "base" not in source.signals:
        return
    base = middle(source, MOST_SAMPLES).measured("base")
    distance = float(np.linalg.norm(np.ptp(base[:, :3], axis=0)))
    if distance > RESTS:
        yield diagnose("recording.base-moves", "the base", distance)


def import_and_check(
    path: Path,
    robot_of: Callable[[Recording], tuple[Tree, Source]],
    *,
    align: bool = False,
    unchecked: bool = False,
    progress: Progress | None = None,
    prepared: Prepared | None = None,
) -> tuple[tuple[Recording, ...], list[Diagnostic], CheckReport]:
    """Recordings made by a mapping file, the longest of which is held against its robot.

    Args:
        path: The mapping file.
        robot_of: The robot of a recording, its masses right within a factor of a few, and the
            recording as its.
        align: Whether delays and drifts of clocks are taken back.
        unchecked: Whether to accept them without a search for what is wrong.
        progress: Called with how much of the search is done.
        prepared: The recordings, where they were made already.

    Returns:
        The recording, or its pieces where a source was silent for too long, with the verdict, and
        where it was cut; and what it shows before anything is taken back.

    Raises:
        ExperimentError: The mapping is not understood.
        RecordingError: A file is damaged, or the recording cannot be true of this robot.
    """
    prepared = prepared or Prepared(*pieces(path))
    longest = prepared.longest
    tree, own = robot_of(longest)
    report = check_recording(
        tree,
        own,
        align=align,
        unchecked=unchecked,
        progress=progress,
        prepared=prepared,
    )
    lines = _alignment(report.offsets, longest)
    if align and lines:
        mapping = with_lines(longest.metadata.mapping or {}, lines)
        prepared = Prepared(*pieces(path, checked(Mapping, mapping, str(path))))
        longest = prepared.longest
        tree, own = robot_of(longest)
        late = "recording.delay"  # was just taken back
        kept = tuple(each for each in report.diagnostics if each.code != late)
        report = replace(report, diagnostics=kept)
    if unchecked:
        return prepared.recordings, prepared.cuts, report
    verdict = {
        "of": digest(tree, own),
        "diagnostics": [each.as_dict() for each in report.diagnostics],
    }
    held = replace(longest, metadata=replace(longest.metadata, verdict=verdict))
    recordings = tuple(
        held if each is longest else each for each in prepared.recordings
    )
    return recordings, prepared.cuts, report


def _alignment(offsets: Sequence[TimeOffset], source: Source) -> list[Any]:
    """Lines of a mapping that take offsets back."""
    mapping, report = source.metadata.mapping or {}, source.metadata.report
    return [line for each in offsets for line in alignment(each, mapping, report)]


def digest(tree: Tree, source: Source) -> str:
    """Hash of all that a verdict depends on: the data, what the mapping says, the robot.

    Args:
        tree: The robot.
        source: The recording.
    """
    facts = [
        METHOD,
        source.names,
        source.rate,
        source.samples,
        source.metadata.mapping,
        source.metadata.gravity,
        {name: asdict(each) for name, each in geometry(tree).items()},
        standard(tree),
        tree.gravity,
        [joint.position_range for joint in tree.joints],
        source.tare,
        tree.floating,
    ]
    text = json.dumps(facts, sort_keys=True, default=np.ndarray.tolist)
    part = middle(source, MOST_SAMPLES)
    signals = [part.time, part.position, part.torque, part.wrench]
    data = [values.tobytes() for values in signals if values is not None]
    return hashlib.sha256(b"".join([text.encode(), *data])).hexdigest()
