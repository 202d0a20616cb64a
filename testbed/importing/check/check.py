"""A recording held against its robot before anything is estimated."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.diagnostics import (
    Diagnosed,
    Diagnostic,
    diagnose,
    from_json,
    of_instrument,
    sentences,
)
from testbed.core.base.errors import RecordingError
from testbed.core.base.toml_text import checked
from testbed.core.estimation.estimate import sensor_of
from testbed.core.parameters.symbols import standard
from testbed.core.recordings.geometry import check_robot, geometry, in_its_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.recordings.views import on_its_base
from testbed.core.robot.rotations import from_rpy
from testbed.core.robot.tree import Tree
from testbed.importing.check.explanation import APART, Explanation
from testbed.importing.check.instants import CUTOFF, SLOW, middle
from testbed.importing.check.plate import WrenchFit
from testbed.importing.check.plate_map import rotation_vector
from testbed.importing.check.recording_diagnostics import (
    at_rest,
    clocked,
    encoder_steps,
    faulty_channels,
    negative_weight,
    odd_sizes,
    other_zero,
    out_of_range,
    share,
    spikes,
    still_joints,
    undecided,
    unexplained_plate,
    unknown_gains,
    unsaid_pedestal,
    wrong_mapping,
)
from testbed.importing.check.remedies import (
    Hypothesis,
    Remedy,
    in_words,
    remedies_for,
    with_lines,
)
from testbed.importing.check.search import Progress, Search
from testbed.importing.check.sensor_errors import diagnostic, sensor_error
from testbed.importing.check.time_offset import TimeOffset, alignment, time_offsets
from testbed.importing.convert import pieces
from testbed.importing.import_report import in_mapping
from testbed.importing.mapping import Mapping

CERTAIN, LIKELY = 12.0, 6.0
"""Differences of minus the log likelihood from which a hypothesis is certain, or likely."""

WELL, NOISY, TIMES = 0.4, 3.0, 4.0
"""Part of a channel's variance that may be left where a hypothesis is called certain, times its
noise's part that may be left besides; and times less than before that must be left."""

EXPLAINING = 0.5
"""Part of a torque up to which remedies may leave it unexplained; others explain nothing."""

ALONG = 1e-3
"""By how much a rotation vector may leave a joint's axis [rad]."""

MOVED, CLEAR = 0.03, 5.0
"""Parts of the robot's weight, for moments at a lever of 1 m, and sigmas, from which a plate's zero
is another one."""

RESTS = 5e-3
"""By how much a base that is welded may seem to move [m]."""

METHOD = 3
"""Of the check; another number and what was kept counts no more."""

MOST_SAMPLES = 200_000
"""Samples that are looked at, from the recording's middle."""


@dataclass(frozen=True, eq=False)
class Assessment(Diagnosed):
    """What supports or contradicts a recording.

    Attributes:
        diagnostics: What is certainly wrong, an error each; what may be; what is left open.
        sizes: Torques over what the model file's masses say, nan if unknown, (n,) or (0,).
        remedies: What would make it right, to be applied together; empty where nothing is wrong.
        equals: What explains the recording as well, in words.
        as_read: The recording as it is; None where nothing can be judged.
        best: What explains the recording best; None where nothing can be judged.
    """

    diagnostics: tuple[Diagnostic, ...]
    sizes: Array = field(default_factory=lambda: np.zeros(0))
    remedies: tuple[Remedy, ...] = ()
    equals: tuple[str, ...] = ()
    as_read: Explanation | None = None
    best: Explanation | None = None

    @property
    def certain(self) -> tuple[Diagnostic, ...]:
        """What is certainly wrong."""
        return tuple(each for each in self.diagnostics if each.level == "error")

    @property
    def likely(self) -> tuple[Diagnostic, ...]:
        """What may be wrong."""
        return tuple(each for each in self.diagnostics if each.level == "warning")

    @property
    def wrench_fit(self) -> WrenchFit | None:
        """The plate as it was read beside what explains it; None where there is none."""
        as_read = self.as_read
        if as_read is None or not as_read.has_plate:
            return None
        return as_read.fit.plate.wrench_fit(as_read.plate)

    def require(self, *, align: bool = False) -> None:
        """Stop where something is certainly wrong.

        Args:
            align: Whether clocks are set right besides.

        Raises:
            RecordingError: Says what is wrong, and what would make it right.
        """
        late = len(self.certain) == 1 and [each.kind for each in self.remedies] == [
            "late"
        ]
        if self.certain and not (align and late):
            lines = "; ".join(sentences(self.certain))
            raise RecordingError(f"the recording cannot be true of this robot: {lines}")


@one_blas_thread()  # matrices are small: more threads would only wait for each other
def assess(tree: Tree, source: Source, progress: Progress | None = None) -> Assessment:
    """What supports or contradicts a recording.

    Args:
        tree: The robot, its masses right within a factor of a few; not used for estimates.
        source: The recording.
        progress: Called with how much of the search is done.

    Raises:
        RecordingError: It is of another robot.
    """
    check_robot(source, tree)
    tree = in_its_gravity(tree, source)
    part = middle(source, MOST_SAMPLES).ordered(tree)
    odd = tuple(spikes(part))
    if odd:
        return Assessment(odd)
    beyond = tuple(out_of_range(tree, part.position))
    assessment = _judge(tree, part, beyond, CUTOFF, progress)
    best = assessment.best
    if best is not None and not best.plate.explained():
        # noise may hide what is below it
        slow = _judge(tree, part, beyond, SLOW, progress)
        if slow.best is not None and slow.best.plate.cost < best.plate.cost - APART:
            assessment = slow
    named = of_instrument(assessment.diagnostics, sensor_of(tree))
    return replace(assessment, diagnostics=(*faulty_channels(part), *named))


def _judge(
    tree: Tree,
    part: Recording,
    beyond: Sequence[Diagnostic],
    cutoff: float,
    progress: Progress | None,
) -> Assessment:
    """What explanations say of a recording up to a cutoff; `beyond`: of positions out of range."""
    mapping = part.metadata.mapping or {}
    search = Search(tree, part, mapping, cutoff, progress)
    if search.first is None:
        return Assessment(tuple(beyond))
    rest = tuple(at_rest(tree, search.first.instants))
    if rest:
        return Assessment((*beyond, *rest))
    as_read, explanations = search.best()
    best = explanations[0]
    gain = as_read.cost - best.cost
    clear = gain > CERTAIN and _explains(as_read, best)
    plate = list(unexplained_plate(best))
    changing = sensor_error(best) if best.has_plate else None
    if changing is not None:
        mended = changing.explains(best)
        plate = [*([] if mended else plate), diagnostic(changing, best)]
    foreign = any(each.level == "error" for each in plate)
    still = list(still_joints(tree, as_read))
    if any(each.value for each in still) and (foreign or not clear):
        doubted = [
            replace(each, level="error" if foreign else "warning") for each in still
        ]
        return Assessment(tuple(doubted), best.torques.sizes)
    wrong = gain > LIKELY and not foreign
    believed = [
        each for each in best.hypotheses if wrong and each.kind != "torque_size"
    ]
    hypotheses = [_timed(each, best) for each in believed]
    wrong = bool(hypotheses)
    zero = None if foreign or not best.has_plate else zero_hypothesis(best, part.tare)
    hypotheses += [] if zero is None else [zero]
    recorded = replace(as_read, torques=best.torques.as_recorded()).unexplained
    torques = len(best.torques.unexplained)
    remedies = tuple(
        remedies_for(tree, hypotheses, recorded, best.unexplained, mapping, torques)
    )
    equals = tuple(dict.fromkeys(_equals(tree, explanations)))
    said = [] if wrong and clear else [*beyond, *plate]
    vain = [each for each in remedies if each.after > EXPLAINING]
    if wrong and vain and not best.has_plate:
        before, after = share(vain[0].before), share(vain[0].after)
        said.append(
            diagnose(
                "recording.unexplained", vain[0].channel, before=before, after=after
            )
        )
        wrong, remedies = False, ()
    if wrong:
        said.append(wrong_mapping(tree, remedies, equals, gain, certain=clear))
    if not foreign:
        if best.has_plate:
            said += [*negative_weight(best, part.tare), *unsaid_pedestal(best, mapping)]
        if zero is not None and not wrong:
            said.append(other_zero(remedies[-1]))
        sized = any(each.kind == "torque_size" for each in best.hypotheses)
        said += odd_sizes(tree, best.torques.sizes, mapping, certain=sized)
    said += still
    if not (wrong or foreign):
        said += undecided(tree, search.undecided())
    return Assessment(tuple(said), best.torques.sizes, remedies, equals, as_read, best)


def _timed(hypothesis: Hypothesis, best: Explanation) -> Hypothesis:
    """The same; that a plate is late, by what was fitted beside, too."""
    if hypothesis.kind != "late":
        return hypothesis
    return replace(hypothesis, values=(hypothesis.values[0] + best.plate.late,))


def _explains(as_read: Explanation, best: Explanation) -> bool:
    """Whether channels that are explained better than as read are explained well."""
    before, after = as_read.unexplained, best.unexplained
    for each in best.hypotheses:
        if each.kind == "torque_order":  # what is left of a column, whosever it is
            after[list(each.values)] = best.torques.unexplained
    better = (before > TIMES * after) & (before > NOISY * as_read.noise)
    better |= any(each.kind == "shift" for each in best.hypotheses) & (before < WELL)
    return bool(better.any() and (after < WELL + NOISY * best.noise)[better].all())


def zero_hypothesis(
    best: Explanation, tare: Array | None, least: float = MOVED
) -> Hypothesis | None:
    """That a plate shows something without the robot, if it clearly does.

    Args:
        best: What explains the recording best; with a wrench.
        tare: What the recording says that it shows, (6,) [N, N m]; None for the model's pedestal.
        least: Parts of the robot's weight by which it must be another one.
    """
    prior = best.fit.prior
    expected = prior.zero(tare)
    zero, sigma = best.fit.plate.zero(best.plate)
    moved = np.abs(zero - expected) > np.maximum(least * prior.weight, CLEAR * sigma)
    zero = np.where(moved, zero, expected)
    return (
        Hypothesis("tare", (), tuple(np.round(zero, 3).tolist()))
        if moved.any()
        else None
    )


def _equals(tree: Tree, explanations: Sequence[Explanation]) -> Iterator[str]:
    """What else explains a recording as well as the best, which comes first, in words."""
    best, *others = explanations
    root, *roots = [joint for joint in tree.joints if joint.parent < 0]
    for hypothesis in best.hypotheses:
        if hypothesis.kind == "turn" and root.revolute and not roots:
            turn, axis = rotation_vector(from_rpy(hypothesis.values)), root.carried_axis
            if np.linalg.norm(np.cross(turn, axis)) < ALONG:
                yield f"another zero of '{root.name}' ({-np.rad2deg(turn @ axis):.4g} deg)"
    for each in others:
        if each.price < best.price + APART and _signature(each) != _signature(best):
            words = " and ".join(in_words(tree, part) for part in each.hypotheses)
            yield words or "nothing wrong"


def _signature(explanation: Explanation) -> set[tuple[str, tuple[int, ...]]]:
    """Kinds and joints, in which explanations that are alike agree."""
    return {(each.kind, each.joints) for each in explanation.hypotheses}


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
    else:
        verdict = source.metadata.verdict
        if verdict.get("of") == digest(tree, source):
            return CheckReport(diagnostics=from_json(verdict.get("diagnostics", [])))
        assessment = known.assessment or assess(tree, source, progress)
        assessment.require(align=align)
        doubts += [each for each in assessment.diagnostics if each.level != "error"]
    offsets = known.offsets
    if any(each.code == "robot.rest" for each in doubts):
        offsets = ()  # without a motion there is no delay
    if offsets is None:
        offsets = time_offsets(tree, source, clocked(doubts))
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
