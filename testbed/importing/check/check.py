"""Check of a recording against its robot model before any estimation."""

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
    diagnostics_from_json,
    make_diagnostic,
)
from testbed.core.base.errors import RecordingError
from testbed.core.base.toml_text import validate_tables
from testbed.core.parameters.symbols import standard
from testbed.core.recordings.channels import channel_faults
from testbed.core.recordings.geometry import joint_geometry
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.recordings.views import adapt_to_robot
from testbed.core.robot.tree import Tree
from testbed.importing.check.assessment import (
    MAX_CHECKED_SAMPLES,
    Assessment,
    assess_recording,
)
from testbed.importing.check.instants import middle_part
from testbed.importing.check.recording_diagnostics import (
    check_assumed_gains,
    encoder_step_diagnostics,
    signals_to_align,
)
from testbed.importing.check.remedies import mapping_with_lines
from testbed.importing.check.search import Progress
from testbed.importing.check.time_offset import (
    TimeOffset,
    alignment_lines,
    time_offsets,
)
from testbed.importing.convert import import_recordings
from testbed.importing.import_report import mapping_advice
from testbed.importing.mapping import Mapping

MAX_BASE_MOTION = 5e-3
"""Largest apparent motion of a welded base [m]."""

METHOD_VERSION = 4
"""Version of the check; stored results of other versions are not reused."""


@dataclass(frozen=True)
class CheckReport(Diagnosed):
    """Result of the check of a recording before import.

    Attributes:
        offsets: Time offsets of torques and wrench.
        diagnostics: Possible errors, properties that the data leave undetermined, and delayed
            signals.
    """

    offsets: tuple[TimeOffset, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True)
class PreparedRecordings:
    """Recordings made with a mapping, and the assessment of the longest recording.

    Attributes:
        recordings: Recordings in chronological order.
        gap_diagnostics: Diagnostics of gaps at which the data were cut.
        assessment: Assessment of the longest recording; None if not assessed.
        time_offsets: Time offsets of torques and wrench in the longest recording; None if unknown.
    """

    recordings: tuple[Recording, ...]
    gap_diagnostics: list[Diagnostic]
    assessment: Assessment | None = None
    time_offsets: Sequence[TimeOffset] | None = None

    @property
    def longest(self) -> Recording:
        """Recording with the most samples."""
        return max(self.recordings, key=lambda each: each.samples)


def check_recording(
    tree: Tree,
    source: Source,
    *,
    align: bool = False,
    unchecked: bool = False,
    progress: Progress | None = None,
    prepared: PreparedRecordings | None = None,
) -> CheckReport:
    """Check a recording against its robot, unless a stored result is still valid.

    A result in the recording's metadata is valid if the `digest` of data, mapping and robot is
    unchanged. Delays of torques and wrench are estimated after the search for errors.

    Args:
        tree: Robot, with masses that are right within a factor of a few.
        source: Recording.
        align: True if clocks are corrected afterwards: a force plate whose only error is a delay is
            then accepted.
        unchecked: True to accept the recording without the search for errors.
        progress: Callback with the number of fitted hypotheses.
        prepared: Results already known for the recording.

    Raises:
        RecordingError: The recording contradicts this robot, and the message lists corrections; or
            the base moves in the recording but is welded in the model.
    """
    source = adapt_to_robot(source, tree)
    diagnostics = [] if tree.floating else [*_base_motion_diagnostics(source)]
    if diagnostics and not unchecked:
        raise RecordingError(str(diagnostics[0]))
    diagnostics += [*encoder_step_diagnostics(source), *check_assumed_gains(source)]
    results = prepared or PreparedRecordings((), [])
    if unchecked:
        diagnostics.append(make_diagnostic("recording.unchecked"))
        faults = channel_faults(source)
    else:
        verdict = source.metadata.verdict
        if verdict.get("of") == digest(tree, source):
            return CheckReport(
                diagnostics=diagnostics_from_json(verdict.get("diagnostics", []))
            )
        assessment = results.assessment or assess_recording(tree, source, progress)
        assessment.raise_errors(align=align)
        diagnostics += [
            each for each in assessment.diagnostics if each.level != "error"
        ]
        faults = assessment.channel_faults
    offsets = results.time_offsets
    if any(each.code == "robot.rest" for each in diagnostics):
        offsets = ()  # without a motion there is no delay
    if offsets is None:
        offsets = time_offsets(tree, source, signals_to_align(source, faults))
    for each in offsets:
        if each.is_significant:
            lines = mapping_advice(_alignment_lines([each], source))
            diagnostics.append(
                each.diagnostic(f"{lines}, or import with --model and --align")
            )
    return CheckReport(tuple(offsets), tuple(diagnostics))


def _base_motion_diagnostics(source: Source) -> Iterator[Diagnostic]:
    """Yield a diagnostic if a base welded in the model moves by over 5 mm.

    The motion is measured by the diagonal of the box that contains all positions of the base.
    """
    if "base" not in source.signals:
        return
    base = middle_part(source, MAX_CHECKED_SAMPLES).measured("base")
    distance = float(np.linalg.norm(np.ptp(base[:, :3], axis=0)))
    if distance > MAX_BASE_MOTION:
        yield make_diagnostic("recording.base-moves", "the base", distance)


def import_and_check(
    path: Path,
    robot_of: Callable[[Recording], tuple[Tree, Source]],
    *,
    align: bool = False,
    unchecked: bool = False,
    progress: Progress | None = None,
    prepared: PreparedRecordings | None = None,
) -> tuple[tuple[Recording, ...], list[Diagnostic], CheckReport]:
    """Import the recordings of a mapping file and check the longest one against its robot.

    The result is stored in the metadata of the longest recording, unless `unchecked` is True. If
    `align` is True and delays or drifts are significant, they are corrected in the mapping, and the
    files are imported again.

    Args:
        path: Mapping file.
        robot_of: Function that maps a recording to its robot, with masses that are right within a
            factor of a few, and to the recording adapted to the robot.
        align: True to correct delays and drifts of clocks.
        unchecked: True to accept the recordings without the search for errors.
        progress: Callback with the number of fitted hypotheses.
        prepared: Recordings, if already made.

    Returns:
        Recordings (several if a source has long gaps), the longest with the result of the check;
        diagnostics of the gaps; and the report of the check before clocks are corrected.

    Raises:
        ExperimentError: The mapping is invalid.
        RecordingError: A file is damaged, or the recording contradicts this robot.
    """
    prepared = prepared or PreparedRecordings(*import_recordings(path))
    longest = prepared.longest
    tree, source = robot_of(longest)
    report = check_recording(
        tree,
        source,
        align=align,
        unchecked=unchecked,
        progress=progress,
        prepared=prepared,
    )
    lines = _alignment_lines(report.offsets, longest)
    if align and lines:
        mapping = mapping_with_lines(longest.metadata.mapping or {}, lines)
        prepared = PreparedRecordings(
            *import_recordings(path, validate_tables(Mapping, mapping, str(path)))
        )
        longest = prepared.longest
        tree, source = robot_of(longest)
        delay_code = "recording.delay"  # just corrected
        remaining = tuple(
            each for each in report.diagnostics if each.code != delay_code
        )
        report = replace(report, diagnostics=remaining)
    if unchecked:
        return prepared.recordings, prepared.gap_diagnostics, report
    verdict = {
        "of": digest(tree, source),
        "diagnostics": [each.as_dict() for each in report.diagnostics],
    }
    checked_recording = replace(
        longest, metadata=replace(longest.metadata, verdict=verdict)
    )
    recordings = tuple(
        checked_recording if each is longest else each for each in prepared.recordings
    )
    return recordings, prepared.gap_diagnostics, report


def _alignment_lines(offsets: Sequence[TimeOffset], source: Source) -> list[Any]:
    """Lines of a mapping that correct time offsets."""
    mapping, report = source.metadata.mapping or {}, source.metadata.report
    return [line for each in offsets for line in alignment_lines(each, mapping, report)]


def digest(tree: Tree, source: Source) -> str:
    """SHA-256 hash of data, mapping and robot, on which the result of a check depends.

    Args:
        tree: Robot.
        source: Recording.
    """
    facts = [
        METHOD_VERSION,
        source.names,
        source.rate,
        source.samples,
        source.metadata.mapping,
        source.metadata.gravity,
        {name: asdict(each) for name, each in joint_geometry(tree).items()},
        standard(tree),
        tree.gravity,
        [joint.position_range for joint in tree.joints],
        source.tare,
        tree.floating,
    ]
    text = json.dumps(facts, sort_keys=True, default=np.ndarray.tolist)
    part = middle_part(source, MAX_CHECKED_SAMPLES)
    signals = [part.time, part.position, part.torque, part.wrench]
    data = [values.tobytes() for values in signals if values is not None]
    return hashlib.sha256(b"".join([text.encode(), *data])).hexdigest()
