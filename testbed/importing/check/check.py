"""A recording held against its robot before anything is estimated: the room's front door."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.diagnostics import (
    Diagnosed,
    Diagnostic,
    Level,
    diagnose,
    of_instrument,
    of_recording,
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
from testbed.core.robot.inertia import from_rpy
from testbed.core.robot.tree import Tree
from testbed.importing.check.explanation import Explanation
from testbed.importing.check.plate import WrenchFit
from testbed.importing.check.plate_map import rotation_vector
from testbed.importing.check.recording_diagnostics import (
    Alternatives,
    at_rest,
    encoder_steps,
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
from testbed.importing.check.time_offset import TimeOffset, alignment, time_offsets
from testbed.importing.convert import pieces
from testbed.importing.import_report import Line, in_mapping
from testbed.importing.mapping import Mapping

CERTAIN, LIKELY = 12.0, 6.0
"""Differences of minus the logarithm of likelihood from which a hypothesis is certain, or likely.
"""

WELL, NOISY, TIMES = 0.4, 3.0, 4.0
"""Part of a channel's variance that may be left where a hypothesis is called certain, times its
noise's part that may be left besides; and times less than before that must be left."""

EXPLAINING = 0.5
"""Part of a torque up to which remedies may leave it unexplained; others explain nothing."""

SAME = np.deg2rad(3.0)
"""Difference of zeros that are no other ones [rad]."""

ALONG = 1e-3
"""By how much a turn's vector may leave a joint's axis [rad]."""

MOVED, CLEAR, ARM = 0.03, 5.0, 1.0
"""Parts of the robot's weight, and sigmas, from which a plate's zero is another one; lever by which
a weight counts as a moment [m]."""

RobotOf = Tree | Callable[[Recording], tuple[Tree, Source]]
"""A robot, or what it is for a recording, whose joints may be held, and the recording as its."""

MOST_SAMPLES = 200_000
"""Samples that are looked at, from the recording's middle."""


@dataclass(frozen=True, eq=False)
class Assessment(Diagnosed):
    """What supports or contradicts a recording.

    Attributes:
        diagnostics: What is certainly wrong, an error each; what may be; what is left open.
        sizes: Torques are so many times what the model file's masses say; nan where they do not
            identify, (n,) or (0,).
        remedies: What would make it right, to be applied together; empty where nothing is wrong.
        alternatives: What else explains it.
        as_read: The recording as it is; None where nothing can be judged.
        explanations: What explains it, the best first; none where nothing can be judged.
    """

    diagnostics: tuple[Diagnostic, ...]
    sizes: Array = field(default_factory=lambda: np.zeros(0))
    remedies: tuple[Remedy, ...] = ()
    alternatives: Alternatives = field(default_factory=Alternatives)
    as_read: Explanation | None = None
    explanations: tuple[Explanation, ...] = ()

    @property
    def certain(self) -> tuple[Diagnostic, ...]:
        """What is certainly wrong."""
        return tuple(each for each in self.diagnostics if each.level == "error")

    @property
    def likely(self) -> tuple[Diagnostic, ...]:
        """What may be wrong."""
        return tuple(each for each in self.diagnostics if each.level == "warning")

    @property
    def best(self) -> Explanation | None:
        """What explains the recording best."""
        return self.explanations[0] if self.explanations else None

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
        late = len(self.certain) == 1 and [each.kind for each in self.remedies] == ["late"]
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
    first = max(0, (source.samples - MOST_SAMPLES) // 2)
    part = source.part(first, min(source.samples, first + MOST_SAMPLES)).ordered(tree)
    odd = tuple(spikes(part))
    if odd:
        return Assessment(odd)
    mapping: dict[str, Any] = source.facts.get("mapping", {})
    search = Search(tree, part, mapping, progress)
    beyond = tuple(out_of_range(tree, part.position))
    if search.instants is None:
        return Assessment(beyond)
    rest = of_instrument(at_rest(tree, search.instants), sensor_of(tree))
    if rest:
        return Assessment((*beyond, *rest))
    found = _judge(tree, mapping, source.tare, beyond, search)
    return replace(found, diagnostics=of_instrument(found.diagnostics, sensor_of(tree)))


def _judge(
    tree: Tree, mapping: dict[str, Any], tare: Array | None, beyond: Sequence[Diagnostic],
    search: Search,
) -> Assessment:  # fmt: skip
    """What explanations say for and against a recording; `beyond`: of positions out of range."""
    as_read, explanations = search.best()
    best = explanations[0]
    sizes, torques = best.torques.sizes, len(best.torques.unexplained)
    gain = as_read.cost - best.cost
    clear = gain > CERTAIN and _explains(as_read, best)
    plate = tuple(unexplained_plate(best))
    foreign = any(each.level == "error" for each in plate)
    still = tuple(still_joints(tree, as_read))
    if any(each.value for each in still) and (foreign or not clear):
        level: Level = "error" if foreign else "warning"
        return Assessment(tuple(replace(each, level=level) for each in still), sizes)
    wrong = []
    if gain > LIKELY and not foreign:
        wrong = [_timed(each, best) for each in best.hypotheses if each.kind != "torque_size"]
    zero = None if foreign or not best.has_plate else zero_hypothesis(best, tare)
    hypotheses = wrong if zero is None else [*wrong, zero]
    before = as_read.unexplained
    before[:torques] = best.torques.unexplained_as_recorded
    remedies = remedies_for(tree, hypotheses, before, best.unexplained, mapping, torques)
    others = _alternatives(tree, explanations)
    said = [] if wrong and clear else list(beyond)
    nothing = [each for each in remedies if wrong and each.after > EXPLAINING]
    if nothing and not best.has_plate:
        worst, wrong, remedies = nothing[0], [], ()
        said.append(
            diagnose(
                "recording.unexplained",
                worst.channel,
                before=share(worst.before),
                after=share(worst.after),
            )
        )
    if not (wrong and clear):
        said += plate
    if wrong:
        said.append(wrong_mapping(tree, remedies, others, gain, certain=clear))
    if not foreign:
        if best.has_plate:
            said += [*negative_weight(best, tare), *unsaid_pedestal(best, mapping)]
        if zero is not None and not wrong:
            said.append(other_zero(remedies[-1]))
        sized = any(each.kind == "torque_size" for each in best.hypotheses)
        said += odd_sizes(tree, sizes, mapping, certain=sized)
    said += still
    if not (wrong or foreign):
        said += undecided(tree, search.undecided())
    return Assessment(tuple(said), sizes, remedies, others, as_read, tuple(explanations))


def _timed(hypothesis: Hypothesis, best: Explanation) -> Hypothesis:
    """The same; that a plate is late, by what was fitted beside, too."""
    if hypothesis.kind != "late":
        return hypothesis
    return replace(hypothesis, values=(hypothesis.values[0] + best.plate.late,))


def _explains(as_read: Explanation, best: Explanation) -> bool:
    """Whether channels that are explained better than as they were read are explained well."""
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
    zero, sigma = best.fit.plate.zero(best.plate)
    smallest = least * prior.weight * np.repeat([1.0, ARM], 3)
    moved = np.abs(zero - prior.zero(tare)) > np.maximum(smallest, CLEAR * sigma)
    zero = np.where(moved, zero, prior.zero(tare))
    return Hypothesis("tare", (), tuple(np.round(zero, 3).tolist())) if moved.any() else None


def _alternatives(tree: Tree, explanations: Sequence[Explanation]) -> Alternatives:
    """What else explains a recording, that is none like the best, which comes first."""
    best, *others = explanations
    most = best.cost + best.tolerance
    equals = dict.fromkeys(_equal_zeros(tree, best.hypotheses))
    for each in others:
        if each.cost <= most and each.count <= best.count and not _alike(each, best):
            words = " and ".join(in_words(tree, hypothesis) for hypothesis in each.hypotheses)
            equals[words or "nothing wrong"] = None
    worse = [each for each in others if each.cost > most and not _alike(each, best)]
    if not worse:
        return Alternatives(equals=tuple(equals))
    nearest = min(worse, key=lambda each: each.cost)
    more, least = (
        float((each.plate if each.has_plate else each.torques).unexplained.sum())
        for each in (nearest, best)
    )
    beside = [each for each in nearest.hypotheses if each not in best.hypotheses]
    runner_up = tuple(in_words(tree, each) for each in beside)
    return Alternatives(runner_up, more / (least + 1e-9), tuple(equals))


def _equal_zeros(tree: Tree, hypotheses: Sequence[Hypothesis]) -> Iterator[str]:
    """Zeros of the first joint that are the same as a turn of the plate's frame about its axis."""
    roots = [joint for joint in tree.joints if joint.parent < 0]
    for each in hypotheses:
        if each.kind != "turn" or len(roots) != 1 or not roots[0].revolute or tree.floating:
            continue
        turn, axis = rotation_vector(from_rpy(each.values)), roots[0].carried_axis
        angle = float(turn @ axis)
        if np.linalg.norm(turn - angle * axis) < ALONG:
            yield f"another zero of '{roots[0].name}' ({-np.rad2deg(angle):.4g} deg)"


def _alike(one: Explanation, other: Explanation) -> bool:
    """Whether two explanations are the same, zeros and turns to a few degrees."""
    pairs = zip_longest(_sorted(one), _sorted(other), fillvalue=Hypothesis("zero"))
    return all(a == b or _near(a, b) for a, b in pairs)


def _sorted(one: Explanation) -> list[Hypothesis]:
    return sorted(one.hypotheses, key=lambda each: (each.kind, each.joints))


def _near(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two hypotheses are one, but for what noise makes of it."""
    if (one.kind, one.joints) != (other.kind, other.joints):
        return False
    if one.kind == "turn":
        apart = rotation_vector(from_rpy(one.values) @ from_rpy(other.values).T)
        return bool(np.linalg.norm(apart) < SAME)
    zeros = one.kind == "zero" and np.allclose(one.values, other.values, atol=SAME)
    return one.kind in ("shift", "tare") or zeros


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
    progress: Progress | None = None, assessment: Assessment | None = None,
) -> CheckReport:  # fmt: skip
    """Hold a recording against its robot; one that keeps a verdict is not held again.

    Args:
        tree: The robot, its masses right within a factor of a few.
        source: The recording.
        align: Whether clocks are set right besides: a late plate does not stop then.
        unchecked: Whether to accept it without a search for what is wrong.
        progress: Called with how much of the search is done.
        assessment: Of this recording, where it was made already.

    Raises:
        RecordingError: The recording cannot be true of this robot; says what would make it right.
    """
    source = on_its_base(source, tree)
    doubts = [] if tree.floating else [*_base_motion(source)]
    if doubts and not unchecked:
        raise RecordingError(str(doubts[0]))
    doubts += [*encoder_steps(source), *unknown_gains(source)]
    if unchecked:
        doubts.append(diagnose("recording.unchecked"))
    else:
        verdict = source.facts.get(FACT) or {}
        if verdict.get("of") == digest(tree, source):
            return CheckReport(diagnostics=of_recording(verdict))
        assessment = assessment or assess(tree, source, progress)
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
    path: Path, robot_of: RobotOf, *, align: bool = False, unchecked: bool = False,
    progress: Progress | None = None, assessment: Assessment | None = None,
) -> tuple[tuple[Recording, ...], list[Diagnostic], CheckReport]:  # fmt: skip
    """Recordings made by a mapping file, the longest of which is held against its robot.

    Args:
        path: The mapping file.
        robot_of: The robot of a recording, its masses right within a factor of a few, and the
            recording as its; or a tree.
        align: Whether delays and drifts of clocks are taken back.
        unchecked: Whether to accept them without a search for what is wrong.
        progress: Called with how much of the search is done.
        assessment: Of the longest of them, where it was made already.

    Returns:
        The recording, or its pieces where a source was silent for too long, with the verdict;
        where it was cut; and what it shows before anything is taken back.

    Raises:
        ExperimentError: The mapping is not understood.
        RecordingError: A file is damaged, or the recording cannot be true of this robot.
    """
    recordings, cuts = pieces(path)
    longest = max(recordings, key=lambda each: each.samples)
    tree, own = _as_its(longest, robot_of)
    report = check_recording(
        tree, own, align=align, unchecked=unchecked, progress=progress, assessment=assessment
    )
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
            _with_verdict(each, robot_of, report) if each.samples == most else each
            for each in recordings
        )
    return recordings, cuts, report


def _as_its(recording: Recording, robot_of: RobotOf) -> tuple[Tree, Source]:
    """A robot, and a recording as its."""
    if isinstance(robot_of, Tree):
        return robot_of, on_its_base(recording, robot_of)
    return robot_of(recording)


def _alignments(
    offsets: Sequence[TimeOffset], source: Source
) -> Iterator[tuple[TimeOffset, list[Line]]]:
    """Offsets that are no noise, and lines of the mapping that take them back."""
    mapping = source.facts.get("mapping", {})
    for each in offsets:
        if each.matters:
            yield each, [*alignment(each, mapping, source.facts)]


def _with_verdict(recording: Recording, robot_of: RobotOf, report: CheckReport) -> Recording:
    """A recording that keeps what was said of it."""
    of = digest(*_as_its(recording, robot_of))
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
