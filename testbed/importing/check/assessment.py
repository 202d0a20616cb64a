"""Check of a recording against its robot, using force plate and joint torques."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.diagnostics import (
    Diagnosed,
    Diagnostic,
    sentences,
    worded_for_sensor,
)
from testbed.core.base.errors import RecordingError
from testbed.core.estimation.estimate import robot_sensor_label
from testbed.core.recordings.channels import ChannelFault, channel_faults
from testbed.core.recordings.geometry import check_robot, with_recorded_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.rotations import rpy_to_matrix
from testbed.core.robot.tree import Tree
from testbed.importing.check.body_prior import plate_prior
from testbed.importing.check.explanation import MIN_HYPOTHESIS_GAIN, Explanation
from testbed.importing.check.instants import (
    CUTOFF,
    SLOW_CUTOFF,
    low_passed_instants,
    middle_part,
)
from testbed.importing.check.plate import WrenchFit
from testbed.importing.check.plate_map import rotation_vector
from testbed.importing.check.recording_diagnostics import (
    check_plate_residual,
    check_position_ranges,
    check_rest,
    check_spikes,
    check_still_joints,
    check_undetermined_positions,
    check_unstated_pedestal,
    check_weight_sign,
    plate_zero_diagnostic,
    wrong_mapping_diagnostic,
)
from testbed.importing.check.remedies import (
    Hypothesis,
    Remedy,
    corrected_positions,
    hypothesis_description,
    position_offset,
    remedies_for,
)
from testbed.importing.check.search import Progress, Search
from testbed.importing.check.sensor_errors import (
    likeliest_sensor_error,
    sensor_error_diagnostic,
)
from testbed.importing.check.torque_assessment import TorqueAssessment, assess_torques
from testbed.importing.check.torque_verdict import TorqueVerdict

CERTAIN_GAIN, LIKELY_GAIN = 12.0, 6.0
"""Log-likelihood ratios from which a hypothesis is certain, or likely [nats]."""

MAX_UNEXPLAINED, NOISE_FACTOR, MIN_IMPROVEMENT = 0.4, 3.0, 4.0
"""Thresholds for a certain hypothesis: largest unexplained share of a channel's variance, noise
share counted this many times on top; and least ratio of the unexplained shares before and after."""

MAX_TORQUE_RESIDUAL = 0.1
"""Largest unexplained share of a torque's variance, with bodies as identified by the force plate,
for a joint position whose sign is not doubted."""

AXIS_TOLERANCE = 1e-3
"""Largest distance of a rotation vector from a joint's axis for a rotation about that axis [rad].
"""

MIN_ZERO_SHIFT, Z_THRESHOLD = 0.03, 5.0
"""Least changes of a force plate's zero: relative to the robot's weight (moments at a lever of 1
m), and in standard deviations."""

MAX_CHECKED_SAMPLES = 200_000
"""Largest number of samples that are checked, from the recording's middle."""


@dataclass(frozen=True, eq=False)
class Assessment(Diagnosed):
    """Result of the check of a recording against its robot.

    Attributes:
        diagnostics: Errors (certain), warnings (likely), and properties that the data leave
            undetermined.
        torque_scales: Torques relative to the prediction from the model file's masses; nan where
            not identifiable, (n,) or (0,).
        remedies: Corrections of the mapping, to be applied together; empty if nothing is wrong.
        equivalent_explanations: Descriptions of alternative explanations that fit the recording
            equally well: their penalised costs are within `MIN_HYPOTHESIS_GAIN` of the best.
        explanation_as_read: Explanation with the force plate as recorded; None without a force
            plate.
        best_explanation: Best explanation of the force plate; None without a force plate.
        verdict: Result from the torques of a recording without a force plate; None if nothing can
            be tested.
        channel_faults: Faults of single channels.
    """

    diagnostics: tuple[Diagnostic, ...]
    torque_scales: Array = field(default_factory=lambda: np.zeros(0))
    remedies: tuple[Remedy, ...] = ()
    equivalent_explanations: tuple[str, ...] = ()
    explanation_as_read: Explanation | None = None
    best_explanation: Explanation | None = None
    verdict: TorqueVerdict | None = None
    channel_faults: tuple[ChannelFault, ...] = ()

    @property
    def has_evidence(self) -> bool:
        """True if a force plate or torques could be tested."""
        return self.best_explanation is not None or self.verdict is not None

    @property
    def errors(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of certain errors."""
        return tuple(each for each in self.diagnostics if each.level == "error")

    @property
    def warnings(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of possible errors, with level "warning"."""
        return tuple(each for each in self.diagnostics if each.level == "warning")

    @property
    def wrench_fit(self) -> WrenchFit | None:
        """Channels of the force plate as recorded, with best fit; None without a force plate."""
        as_read = self.explanation_as_read
        if as_read is None:
            return None
        return as_read.fit.plate.wrench_fit(as_read.plate)

    def raise_errors(self, *, align: bool = False) -> None:
        """Raise an error if the recording certainly contradicts the robot.

        Args:
            align: True if clocks are corrected afterwards: a single error whose only remedy is a
                delay of the force plate is then accepted.

        Raises:
            RecordingError: The recording contradicts the robot; the message lists errors and
                corrections.
        """
        late = len(self.errors) == 1 and [each.kind for each in self.remedies] == [
            "late"
        ]
        if self.errors and not (align and late):
            lines = "; ".join(sentences(self.errors))
            raise RecordingError(f"the recording cannot be true of this robot: {lines}")


@one_blas_thread()  # matrices are small: more threads would only wait for each other
def assess_recording(
    tree: Tree, source: Source, progress: Progress | None = None
) -> Assessment:
    """Check a recording against its robot, using force plate and joint torques.

    If there are spikes, the check ends. With a force plate, hypotheses on errors of the mapping are
    tested on signals below 8 Hz, and below 2 Hz if the plate remains unexplained. Joint torques,
    with or without a plate, are tested by Bayesian evidence (`assess_torques`).

    Args:
        tree: Robot, with masses that are right within a factor of a few.
        source: Recording; at most its middle `MAX_CHECKED_SAMPLES` samples are checked.
        progress: Callback with the number of fitted hypotheses.

    Raises:
        RecordingError: The recording belongs to another robot.
    """
    check_robot(source, tree)
    tree = with_recorded_gravity(tree, source)
    part = middle_part(source, MAX_CHECKED_SAMPLES).ordered(tree)
    spike_diagnostics = tuple(check_spikes(part))
    if spike_diagnostics:
        return Assessment(spike_diagnostics)
    range_diagnostics = tuple(check_position_ranges(tree, part.position))
    faults = channel_faults(part)
    if part.wrench is None:
        return _with_faults(
            _torque_assessment(tree, part, range_diagnostics, faults), faults
        )
    assessment = _plate_assessment(
        tree, part, range_diagnostics, CUTOFF, progress, faults
    )
    best = assessment.best_explanation
    if best is not None and not best.plate.is_explained():
        # noise at higher frequencies may hide the signal below
        slow_assessment = _plate_assessment(
            tree, part, range_diagnostics, SLOW_CUTOFF, progress, faults
        )
        if (
            slow_assessment.best_explanation is not None
            and slow_assessment.best_explanation.plate.cost
            < best.plate.cost - MIN_HYPOTHESIS_GAIN
        ):
            assessment = slow_assessment
    named = worded_for_sensor(assessment.diagnostics, robot_sensor_label(tree))
    return _with_faults(replace(assessment, diagnostics=named), faults)


def _with_faults(
    assessment: Assessment, faults: tuple[ChannelFault, ...]
) -> Assessment:
    """Assessment with the diagnostics of faulty channels placed first."""
    named = (*(each.diagnostic for each in faults), *assessment.diagnostics)
    return replace(assessment, diagnostics=named, channel_faults=faults)


def _plate_assessment(
    tree: Tree,
    part: Recording,
    range_diagnostics: Sequence[Diagnostic],
    cutoff: float,
    progress: Progress | None,
    faults: Sequence[ChannelFault],
) -> Assessment:
    """Assessment of a recording with a force plate, from signals below a cutoff frequency.

    The mapping is wrong if the best explanation gains more than 6 nats over the plate as recorded.
    This is a warning, or an error if the gain exceeds 12 nats and the improved channels are
    explained well. Joint torques test position signs where a reversed sign leaves the plate's cost
    equal.

    Args:
        tree: Robot.
        part: Recording, or the middle of a long recording.
        range_diagnostics: Diagnostics of positions out of range.
        cutoff: Cutoff frequency of the low-pass filter [Hz].
        progress: Callback with the number of fitted hypotheses.
        faults: Faults of single channels.
    """
    mapping = part.metadata.mapping or {}
    search = Search(tree, part, mapping, cutoff, progress)
    if search.first is None:
        return Assessment(tuple(range_diagnostics))
    rest_diagnostics = tuple(check_rest(tree, search.first.instants))
    if rest_diagnostics:
        return Assessment((*range_diagnostics, *rest_diagnostics))
    as_read, explanations = search.find_best_explanations()
    best = explanations[0]
    gain = as_read.cost - best.cost
    certain = gain > CERTAIN_GAIN and _explains_well(as_read, best)
    plate_diagnostics = list(check_plate_residual(best))
    error_fit = likeliest_sensor_error(best)
    if error_fit is not None:
        error_explains = error_fit.explains_plate(best)
        plate_diagnostics = [
            *([] if error_explains else plate_diagnostics),
            sensor_error_diagnostic(error_fit, best),
        ]
    plate_error = any(each.level == "error" for each in plate_diagnostics)
    torques = _torques_with_plate_bodies(tree, part, best, faults)
    for other in search.explanations_with_reversed_joints(
        best, _joints_with_possible_sign_error(torques)
    ):
        other_torques = _torques_with_plate_bodies(tree, part, other, faults)
        torque_gain = _torque_gain(other_torques, torques)
        if torque_gain > CERTAIN_GAIN:
            best, torques, explanations = other, other_torques, [other]
            gain, certain = gain + torque_gain, True
            break
    still_diagnostics = list(
        check_still_joints(tree, search.first.instants, torques.unexplained)
    )
    if any(each.value for each in still_diagnostics) and (plate_error or not certain):
        graded = [
            replace(each, level="error" if plate_error else "warning")
            for each in still_diagnostics
        ]
        return Assessment(tuple(graded), torques.torque_scales)
    mapping_wrong = gain > LIKELY_GAIN and not plate_error
    hypotheses = [
        _with_fitted_delay(each, best) for each in best.hypotheses if mapping_wrong
    ]
    mapping_wrong = bool(hypotheses)
    zero = None if plate_error else zero_hypothesis(best, part.tare)
    hypotheses += [] if zero is None else [zero]
    before, after = as_read.plate.unexplained, best.plate.unexplained
    remedies = tuple(remedies_for(tree, hypotheses, before, after, mapping, 0))
    equals = tuple(dict.fromkeys(_equivalent_descriptions(tree, explanations)))
    diagnostics = (
        [] if mapping_wrong and certain else [*range_diagnostics, *plate_diagnostics]
    )
    if mapping_wrong:
        diagnostics.append(
            wrong_mapping_diagnostic(tree, remedies, equals, gain, certain=certain)
        )
    if not plate_error:
        diagnostics += [
            *check_weight_sign(best, part.tare),
            *check_unstated_pedestal(best, mapping),
        ]
        if zero is not None and not mapping_wrong:
            diagnostics.append(plate_zero_diagnostic(remedies[-1]))
        diagnostics += torques.diagnostics
        remedies += torques.remedies
    diagnostics += still_diagnostics
    if not (mapping_wrong or plate_error or torques.remedies):
        diagnostics += check_undetermined_positions(
            tree, search.undetermined_hypotheses()
        )
    return Assessment(
        tuple(diagnostics), torques.torque_scales, remedies, equals, as_read, best
    )


def _torque_assessment(
    tree: Tree,
    part: Recording,
    range_diagnostics: Sequence[Diagnostic],
    faults: Sequence[ChannelFault],
) -> Assessment:
    """Assessment of a recording of joint torques without a force plate.

    A recording at rest, or with fewer than `MIN_INSTANTS` instants, is not tested further.
    Diagnostics of positions out of range are omitted if a remedy is found.
    """
    instants = low_passed_instants(part)
    if instants is None:
        return Assessment(tuple(range_diagnostics))
    rest_diagnostics = tuple(check_rest(tree, instants))
    if rest_diagnostics:
        return Assessment((*range_diagnostics, *rest_diagnostics))
    torques = assess_torques(tree, part, faults)
    still_diagnostics = list(check_still_joints(tree, instants, torques.unexplained))
    diagnostics = [
        *([] if torques.remedies else range_diagnostics),
        *torques.diagnostics,
    ]
    if any(each.value for each in still_diagnostics) and not torques.remedies:
        diagnostics, still_diagnostics = [*still_diagnostics, *range_diagnostics], []
    return Assessment(
        (*diagnostics, *still_diagnostics),
        torques.torque_scales,
        torques.remedies,
        verdict=torques.verdict,
    )


def _torques_with_plate_bodies(
    tree: Tree, part: Recording, best: Explanation, faults: Sequence[ChannelFault]
) -> TorqueAssessment:
    """Assessment of the torques, with positions and bodies as identified by the force plate.

    The posterior of the bodies given the plate serves as the prior. The result is empty if there
    are no torques.
    """
    if part.torque is None:
        return TorqueAssessment()
    offset = position_offset(tree, part.metadata.mapping or {})
    position = part.position
    for each in best.fit.hypotheses:
        if each.kind != "late":
            position = corrected_positions(each, position, offset)
    prior = plate_prior(tree, *best.fit.plate.posterior(best.plate)[:2])
    return assess_torques(tree, replace(part, position=position), faults, prior)


def _joints_with_possible_sign_error(torques: TorqueAssessment) -> list[int]:
    """Indices of joints whose position sign, rather than torque sign, may be reversed.

    They are the joints with an accepted hypothesis `torque_sign`, or with more than 10 % of the
    torque's variance unexplained. The list is empty if the torques are right as given.
    """
    verdict = torques.verdict
    if verdict is None or verdict.outcome == "as given":
        return []
    signs = [h.joints for h in verdict.hypotheses if h.kind == "torque_sign"]
    joints = {joint for each in signs for joint in each}
    return sorted(
        joints | set(np.flatnonzero(torques.unexplained > MAX_TORQUE_RESIDUAL).tolist())
    )


def _torque_gain(other: TorqueAssessment, torques: TorqueAssessment) -> float:
    """Log posterior ratio of torques under other positions to torques as corrected [nats].

    Args:
        other: Assessment under the other positions; -inf unless its torques are right as given.
        torques: Assessment under the current positions, with its corrections of torques.
    """
    if other.verdict is None or other.verdict.outcome != "as given":
        return -np.inf
    assert torques.verdict is not None
    first_case = torques.verdict.case
    other_case = replace(other.verdict.case, inflation=first_case.inflation)
    readings = torques.verdict.readings or (first_case.as_given,)
    return other_case.as_given.log_posterior - readings[-1].log_posterior


def _with_fitted_delay(hypothesis: Hypothesis, best: Explanation) -> Hypothesis:
    """Hypothesis with the fitted delay added if it is a delay of the force plate."""
    if hypothesis.kind != "late":
        return hypothesis
    return replace(hypothesis, values=(hypothesis.values[0] + best.plate.delay,))


def _explains_well(as_read: Explanation, best: Explanation) -> bool:
    """Test whether all channels that an explanation improves are explained well.

    A channel is improved if its unexplained share falls by more than a factor of 4, from above 3
    times its noise share. It is explained well if this share is below 0.4 plus 3 times the noise
    share. With a shift of the frame, channels below 0.4 as recorded count as improved. Returns
    False if no channel is improved.
    """
    before, after = as_read.plate.unexplained, best.plate.unexplained
    noise = best.plate.noise
    improved = (before > MIN_IMPROVEMENT * after) & (
        before > NOISE_FACTOR * as_read.plate.noise
    )
    improved |= any(each.kind == "shift" for each in best.hypotheses) & (
        before < MAX_UNEXPLAINED
    )
    return bool(
        improved.any()
        and (after < MAX_UNEXPLAINED + NOISE_FACTOR * noise)[improved].all()
    )


def zero_hypothesis(
    best: Explanation, tare: Array | None, min_shift: float = MIN_ZERO_SHIFT
) -> Hypothesis | None:
    """Hypothesis that the force plate's zero differs from the stated zero; None if insignificant.

    A component is changed if it differs by more than `min_shift` times the robot's weight (moments:
    at a lever of 1 m) and by more than 5 standard deviations; other components keep their stated
    values.

    Args:
        best: Best explanation of the recording, which has a wrench.
        tare: Stated wrench on the plate without the robot, (6,) [N, N m]; None for the model's
            pedestal.
        min_shift: Least change of the zero relative to the robot's weight.
    """
    prior = best.fit.prior
    expected = prior.zero_wrench(tare)
    zero, sigma = best.fit.plate.zero_wrench(best.plate)
    changed = np.abs(zero - expected) > np.maximum(
        min_shift * prior.weight, Z_THRESHOLD * sigma
    )
    zero = np.where(changed, zero, expected)
    return (
        Hypothesis("tare", (), tuple(np.round(zero, 3).tolist()))
        if changed.any()
        else None
    )


def _equivalent_descriptions(
    tree: Tree, explanations: Sequence[Explanation]
) -> Iterator[str]:
    """Yield descriptions of alternative explanations with a similar penalised cost.

    A similar cost is less than `MIN_HYPOTHESIS_GAIN` above the best. A plate turned about the axis
    of the only root joint is equivalent to another zero of this joint.

    Args:
        tree: Robot.
        explanations: Explanations, the best first.
    """
    best, *others = explanations
    root, *roots = [joint for joint in tree.joints if joint.parent < 0]
    for hypothesis in best.hypotheses:
        if hypothesis.kind == "turn" and root.revolute and not roots:
            turn, axis = (
                rotation_vector(rpy_to_matrix(hypothesis.values)),
                root.carried_axis,
            )
            if np.linalg.norm(np.cross(turn, axis)) < AXIS_TOLERANCE:
                yield f"another zero of '{root.name}' ({-np.rad2deg(turn @ axis):.4g} deg)"
    for each in others:
        if (
            each.penalised_cost < best.penalised_cost + MIN_HYPOTHESIS_GAIN
            and _signature(each) != _signature(best)
        ):
            words = " and ".join(
                hypothesis_description(tree, part) for part in each.hypotheses
            )
            yield words or "nothing wrong"


def _signature(explanation: Explanation) -> set[tuple[str, tuple[int, ...]]]:
    """Set of kind and joints of each hypothesis in an explanation."""
    return {(each.kind, each.joints) for each in explanation.hypotheses}
