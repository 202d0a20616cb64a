"""What supports or contradicts a recording, by its plate and its torques."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.diagnostics import (
    Diagnosed,
    Diagnostic,
    of_instrument,
    sentences,
)
from testbed.core.base.errors import RecordingError
from testbed.core.estimation.estimate import sensor_of
from testbed.core.recordings.channels import ChannelFault, channel_faults
from testbed.core.recordings.geometry import check_robot, in_its_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.rotations import from_rpy
from testbed.core.robot.tree import Tree
from testbed.importing.check.body_prior import plate_prior
from testbed.importing.check.explanation import APART, Explanation
from testbed.importing.check.instants import CUTOFF, SLOW, middle, sample
from testbed.importing.check.plate import WrenchFit
from testbed.importing.check.plate_map import rotation_vector
from testbed.importing.check.recording_diagnostics import (
    at_rest,
    negative_weight,
    other_zero,
    out_of_range,
    spikes,
    still_joints,
    undecided,
    unexplained_plate,
    unsaid_pedestal,
    wrong_mapping,
)
from testbed.importing.check.remedies import (
    Hypothesis,
    Remedy,
    corrected,
    in_words,
    position_offset,
    remedies_for,
)
from testbed.importing.check.search import Progress, Search
from testbed.importing.check.sensor_errors import diagnostic, sensor_error
from testbed.importing.check.torque_assessment import TorqueAssessment, assess_torques
from testbed.importing.check.torque_verdict import TorqueVerdict

CERTAIN, LIKELY = 12.0, 6.0
"""Differences of minus the logarithm of likelihood from which a hypothesis is certain, or likely.
"""

WELL, NOISY, TIMES = 0.4, 3.0, 4.0
"""Part of a channel's variance that may be left where a hypothesis is called certain, times its
noise's part that may be left besides; and times less than before that must be left."""

BRAKED = 0.1
"""Part of a torque's variance that a plate's bodies and friction leave at most."""

ALONG = 1e-3
"""By how much a rotation vector may leave a joint's axis [rad]."""

MOVED, CLEAR = 0.03, 5.0
"""Parts of the robot's weight, for moments at a lever of 1 m, and sigmas, from which a plate's zero
is another one."""

MOST_SAMPLES = 200_000
"""Samples that are looked at, from the recording's middle."""


@dataclass(frozen=True, eq=False)
class Assessment(Diagnosed):
    """Result of the check of a recording against its robot.

    Attributes:
        diagnostics: What is certainly wrong, an error each; what may be; what is left open.
        sizes: Torques are so many times what the model file's masses say; nan where they do not
            identify, (n,) or (0,).
        remedies: What would make it right, to be applied together; empty where nothing is wrong.
        equals: What explains the recording as well, in words.
        as_read: The plate as it is read; None without one.
        best: What explains the plate best; None without one.
        verdict: On the torques where there is no plate; None where nothing can be judged.
        faults: Of single channels.
    """

    diagnostics: tuple[Diagnostic, ...]
    sizes: Array = field(default_factory=lambda: np.zeros(0))
    remedies: tuple[Remedy, ...] = ()
    equals: tuple[str, ...] = ()
    as_read: Explanation | None = None
    best: Explanation | None = None
    verdict: TorqueVerdict | None = None
    faults: tuple[ChannelFault, ...] = ()

    @property
    def judged(self) -> bool:
        """Whether there was anything to judge."""
        return self.best is not None or self.verdict is not None

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
        if as_read is None:
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
    """Check a recording against its robot, by plate and torques.

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
    faults = channel_faults(part)
    if part.wrench is None:
        return _with_faults(_judge_torques(tree, part, beyond, faults), faults)
    assessment = _judge(tree, part, beyond, CUTOFF, progress, faults)
    best = assessment.best
    if best is not None and not best.plate.explained():
        # noise may hide what is below it
        slow = _judge(tree, part, beyond, SLOW, progress, faults)
        if slow.best is not None and slow.best.plate.cost < best.plate.cost - APART:
            assessment = slow
    named = of_instrument(assessment.diagnostics, sensor_of(tree))
    return _with_faults(replace(assessment, diagnostics=named), faults)


def _with_faults(
    assessment: Assessment, faults: tuple[ChannelFault, ...]
) -> Assessment:
    """An assessment whose diagnostics begin with faults of single channels."""
    named = (*(each.diagnostic for each in faults), *assessment.diagnostics)
    return replace(assessment, diagnostics=named, faults=faults)


def _judge(
    tree: Tree,
    part: Recording,
    beyond: Sequence[Diagnostic],
    cutoff: float,
    progress: Progress | None,
    faults: Sequence[ChannelFault],
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
    changing = sensor_error(best)
    if changing is not None:
        mended = changing.explains(best)
        plate = [*([] if mended else plate), diagnostic(changing, best)]
    foreign = any(each.level == "error" for each in plate)
    torques = _beside_plate(tree, part, best, faults)
    for other in search.with_senses(best, _doubtful(torques)):
        again = _beside_plate(tree, part, other, faults)
        likelier = _likelier(again, torques)
        if likelier > CERTAIN:
            best, torques, explanations = other, again, [other]
            gain, clear = gain + likelier, True
            break
    still = list(still_joints(tree, search.first.instants, torques.unexplained))
    if any(each.value for each in still) and (foreign or not clear):
        doubted = [
            replace(each, level="error" if foreign else "warning") for each in still
        ]
        return Assessment(tuple(doubted), torques.sizes)
    wrong = gain > LIKELY and not foreign
    hypotheses = [_timed(each, best) for each in best.hypotheses if wrong]
    wrong = bool(hypotheses)
    zero = None if foreign else zero_hypothesis(best, part.tare)
    hypotheses += [] if zero is None else [zero]
    before, after = as_read.plate.unexplained, best.plate.unexplained
    remedies = tuple(remedies_for(tree, hypotheses, before, after, mapping, 0))
    equals = tuple(dict.fromkeys(_equals(tree, explanations)))
    said = [] if wrong and clear else [*beyond, *plate]
    if wrong:
        said.append(wrong_mapping(tree, remedies, equals, gain, certain=clear))
    if not foreign:
        said += [*negative_weight(best, part.tare), *unsaid_pedestal(best, mapping)]
        if zero is not None and not wrong:
            said.append(other_zero(remedies[-1]))
        said += torques.diagnostics
        remedies += torques.remedies
    said += still
    if not (wrong or foreign or torques.remedies):
        said += undecided(tree, search.undecided())
    return Assessment(tuple(said), torques.sizes, remedies, equals, as_read, best)


def _judge_torques(
    tree: Tree,
    part: Recording,
    beyond: Sequence[Diagnostic],
    faults: Sequence[ChannelFault],
) -> Assessment:
    """Assessment of a recording without a plate."""
    instants = sample(part)
    if instants is None:
        return Assessment(tuple(beyond))
    rest = tuple(at_rest(tree, instants))
    if rest:
        return Assessment((*beyond, *rest))
    torques = assess_torques(tree, part, faults)
    still = list(still_joints(tree, instants, torques.unexplained))
    said = [*([] if torques.remedies else beyond), *torques.diagnostics]
    if any(each.value for each in still) and not torques.remedies:
        said, still = [*still, *beyond], []
    return Assessment(
        (*said, *still), torques.sizes, torques.remedies, verdict=torques.verdict
    )


def _beside_plate(
    tree: Tree, part: Recording, best: Explanation, faults: Sequence[ChannelFault]
) -> TorqueAssessment:
    """Assessment of torques with positions and bodies from the plate."""
    if part.torque is None:
        return TorqueAssessment()
    offset = position_offset(tree, part.metadata.mapping or {})
    position = part.position
    for each in best.fit.hypotheses:
        if each.kind != "late":
            position = corrected(each, position, offset)
    prior = plate_prior(tree, *best.fit.plate.posterior(best.plate)[:2])
    return assess_torques(tree, replace(part, position=position), faults, prior)


def _doubtful(torques: TorqueAssessment) -> list[int]:
    """Indices of joints whose position may be reversed instead of the torque."""
    verdict = torques.verdict
    if verdict is None or verdict.outcome == "as given":
        return []
    signs = [h.joints for h in verdict.hypotheses if h.kind == "torque_sign"]
    joints = {joint for each in signs for joint in each}
    return sorted(joints | set(np.flatnonzero(torques.unexplained > BRAKED).tolist()))


def _likelier(other: TorqueAssessment, torques: TorqueAssessment) -> float:
    """Log evidence of torques with other positions over corrected torques [nats]."""
    if other.verdict is None or other.verdict.outcome != "as given":
        return -np.inf
    assert torques.verdict is not None
    first = torques.verdict.case
    again = replace(other.verdict.case, inflation=first.inflation)
    readings = torques.verdict.readings or (first.as_given,)
    return again.as_given.log - readings[-1].log


def _timed(hypothesis: Hypothesis, best: Explanation) -> Hypothesis:
    """The same; that a plate is late, by what was fitted beside, too."""
    if hypothesis.kind != "late":
        return hypothesis
    return replace(hypothesis, values=(hypothesis.values[0] + best.plate.late,))


def _explains(as_read: Explanation, best: Explanation) -> bool:
    """Whether channels that are explained better than as read are explained well."""
    before, after = as_read.plate.unexplained, best.plate.unexplained
    noise = best.plate.noise
    better = (before > TIMES * after) & (before > NOISY * as_read.plate.noise)
    better |= any(each.kind == "shift" for each in best.hypotheses) & (before < WELL)
    return bool(better.any() and (after < WELL + NOISY * noise)[better].all())


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
