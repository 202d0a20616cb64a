"""Bayesian model comparison of interpretations of a torque log, by thresholds.

An interpretation (`LogReading`) is accepted if its residuals are as small as those of correct logs,
its bodies are possible for the robot, and its evidence exceeds that of all others by far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.importing.check.delay_readings import (
    MIN_DELAY_DURATION,
    common_delay,
    delay_readings,
)
from testbed.importing.check.gravity_readings import (
    GRAVITY_DIRECTIONS,
    gravity_readings,
    rounded_to_axis,
    with_dispersion,
)
from testbed.importing.check.position_readings import position_readings
from testbed.importing.check.remedies import Hypothesis
from testbed.importing.check.spring_readings import spring_readings
from testbed.importing.check.torque_columns import (
    compensated_gravity_readings,
    has_contradictory_scales,
    scale_reading,
    torque_order_and_sign_readings,
)
from testbed.importing.check.torque_products import friction_coefficients
from testbed.importing.check.torque_readings import LogReading, TorqueCase

MIN_EVIDENCE_RATIO = 20.0
"""Least log evidence ratio of the best reading to all different readings [nats]."""

EQUAL_EVIDENCE = 0.5
"""Difference of log evidence below which readings have equal evidence [nats]."""

MAX_CHANNEL_RESIDUAL, MAX_TOTAL_RESIDUAL = 0.30, 0.15
"""Largest relative rms residual of the most improved channel, and of all torques. Correct readings
leave 1.6 % of all (median), 4 % (99 %), of real logs 1 to 10 %."""

SMALL_GAIN_REASON = "no joint's torque is explained clearly better"
DISAGREEMENT_REASON = "the joints do not agree on it"
"""Reasons for the rejection of a reading."""

MIN_IMPROVEMENT, MAX_LOSS_SHARE = 1.25, 0.2
"""Ratio of rms residuals for a better, or worse, channel; largest loss of one channel relative to
the total gain of the others."""

MAX_MASS_DEVIATION, MAX_MASS_RMS = 5.0, 2.0
"""Largest normalised deviation of one mass from the model file, and largest rms over masses."""

MAX_TORQUE_SCALE = 2.5
"""Largest common factor by which torques may be too large, or too small, by all masses."""

MAX_DRIVING_FRICTION, FRICTION_Z_THRESHOLD = 0.15, 3.0
"""Largest negative friction: relative to the torque, and in standard deviations."""

UNMODELLED_IMPROVEMENT = 1.5
"""Ratio of a channel's residuals from which an impossible reading reveals an unmodelled error."""

DIRECTION_Z_THRESHOLD = 3.0
"""Normalised angle from which a direction differs."""

MAX_REFINED, MAX_PAIR_STARTS, MAX_MISTAKES = 14, 3, 3
"""Numbers of readings re-evaluated, and tested as the first of two; largest number of successive
mistakes."""

EQUAL_DIRECTION_COSINE = np.cos(np.deg2rad(5))
"""Cosine of the angle below which directions are equivalent."""

DIRECTION_KINDS = ("tilt", "inclined", *GRAVITY_DIRECTIONS)
"""Families of readings with another direction of gravity."""

TERMINAL_KINDS = ("no gravity", "part of gravity", "by file")
"""Families of readings after which no second mistake is searched."""

Outcome = Literal["as given", "explained", "not distinguished", "not explained"]
"""Outcomes of a model comparison."""


class Rejected(NamedTuple):
    """Rejected interpretation that is likelier than the log as given, with the reasons.

    Attributes:
        reading: Rejected interpretation.
        reasons: Reasons for the rejection.
    """

    reading: LogReading
    reasons: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class TorqueVerdict:
    """Result of the model comparison for a log of torques.

    Attributes:
        outcome: "as given" for a correct log, "explained" by interpretations, "not distinguished"
            between interpretations, or "not explained".
        case: Torques as last evaluated.
        readings: Accepted interpretations, applied one after another.
        equivalent_readings: Interpretations with equal evidence, the likeliest first.
        rejected_readings: Likeliest rejected interpretations.
        ranked_readings: All interpretations, the likeliest first.
        log_evidence_ratio: Log evidence of the accepted interpretations relative to the log as
            given [nats].
    """

    outcome: Outcome
    case: TorqueCase
    readings: tuple[LogReading, ...] = ()
    equivalent_readings: tuple[LogReading, ...] = ()
    rejected_readings: tuple[Rejected, ...] = ()
    ranked_readings: tuple[LogReading, ...] = ()
    log_evidence_ratio: float = 0.0

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Hypotheses of all accepted interpretations."""
        return tuple(h for each in self.readings for h in each.hypotheses)


def compare_readings(case: TorqueCase, steps: int = MAX_MISTAKES) -> TorqueVerdict:
    """Compare interpretations of a log, and correct a few mistakes one by one.

    If all single interpretations are rejected, pairs are tried.

    Args:
        case: Joint torques of a log, with robot and prior.
        steps: Largest number of mistakes.
    """
    verdict = single_reading_verdict(case)
    if verdict.outcome == "as given" or steps == 1:
        return verdict
    if verdict.outcome == "explained":
        return _joined_verdict(verdict, steps)
    if verdict.outcome == "not distinguished" or not verdict.rejected_readings:
        return verdict
    return _pair_verdict(verdict)


def _joined_verdict(verdict: TorqueVerdict, steps: int) -> TorqueVerdict:
    """Verdict on the log corrected by an accepted interpretation, joined with the latter."""
    (reading,) = verdict.readings
    if reading.kind in TERMINAL_KINDS:
        return verdict
    remaining = compare_readings(case_without_mistake(verdict.case, reading), steps - 1)
    repeated = reading.kind in [each.kind for each in remaining.readings]
    repeated = repeated and reading.kind not in (*DIRECTION_KINDS, "spring")
    if remaining.outcome == "not explained" or repeated:
        return replace(verdict, outcome="not explained", readings=())
    if remaining.outcome != "explained":
        return replace(verdict, ranked_readings=remaining.ranked_readings)
    return replace(
        remaining,
        readings=(reading, *remaining.readings),
        log_evidence_ratio=verdict.log_evidence_ratio + remaining.log_evidence_ratio,
    )


def _pair_verdict(verdict: TorqueVerdict) -> TorqueVerdict:
    """Verdict from pairs of mistakes, beginning with the likeliest single interpretations.

    The best pair must lead by 20 nats and leave a log that is right as given; otherwise the
    original verdict is returned.
    """
    case, candidates = verdict.case, list[LogReading]()
    for each in verdict.ranked_readings[:12]:
        is_new_kind = all(each.kind != known.kind for known in candidates)
        if each.kind == "torque sizes" and not has_contradictory_scales(each):
            continue
        if each.hypotheses and is_new_kind and each.kind not in TERMINAL_KINDS:
            candidates.append(each)
    pairs = []
    for each in candidates[:MAX_PAIR_STARTS]:
        second_verdict = single_reading_verdict(case_without_mistake(case, each))
        if second_verdict.outcome == "explained":
            pairs.append(
                (
                    second_verdict.readings[0].log_posterior + each.log_odds,
                    each,
                    second_verdict.readings[0],
                )
            )
    pairs.sort(key=lambda pair: -pair[0])
    if not pairs:
        return verdict
    if len(pairs) > 1:
        kinds = [{first.kind, second.kind} for _, first, second in pairs[:2]]
        if pairs[0][0] - pairs[1][0] < MIN_EVIDENCE_RATIO and kinds[0] != kinds[1]:
            return verdict
    _, first, second = pairs[0]
    if (
        single_reading_verdict(
            case_without_mistake(case_without_mistake(case, first), second)
        ).outcome
        != "as given"
    ):
        return verdict
    return replace(
        verdict, outcome="explained", readings=(first, second), rejected_readings=()
    )


def case_without_mistake(case: TorqueCase, reading: LogReading) -> TorqueCase:
    """Case with signals, gravity and springs corrected by an interpretation.

    Args:
        case: Joint torques of a log, with robot and prior.
        reading: Accepted interpretation.
    """
    signals = case.signals.with_corrections(*reading.hypotheses)
    springs = [each.joints for each in reading.hypotheses if each.kind == "spring"]
    return replace(
        case,
        signals=signals,
        gravity=reading.gravity,
        inflation=np.ones(case.tree.n),
        spring_joints=(
            *case.spring_joints,
            *(joint for each in springs for joint in each),
        ),
    )


def single_reading_verdict(case: TorqueCase) -> TorqueVerdict:
    """Compare all single interpretations of a log, and accept at most one.

    Args:
        case: Joint torques of a log, with robot and prior.
    """
    joints = np.flatnonzero(case.usable_channels).tolist()
    if not joints:
        return TorqueVerdict("as given", case)
    readings = [case.as_given, *torque_order_and_sign_readings(case, joints)]
    if not case.motion_known:
        readings += gravity_readings(case)
        readings += compensated_gravity_readings(case)
        readings += position_readings(case, joints)
    readings += spring_readings(case, joints)
    readings += delay_readings(case)
    case = case.with_inflation(max(readings, key=lambda each: each.log_posterior))
    ranked = sorted(
        _refined_readings(case, readings), key=lambda each: -each.log_posterior
    )
    return _threshold_verdict(case, ranked)


def _refined_readings(
    case: TorqueCase, readings: Sequence[LogReading]
) -> list[LogReading]:
    """Likeliest of the interpretations, evaluated again with autocorrelated residuals."""
    directions = [*DIRECTION_KINDS, "part of gravity"]
    others = [each for each in readings[1:] if each.kind not in directions]
    others.sort(key=lambda each: -each.log_posterior)
    refined = [case.as_given]
    for each in others[:MAX_REFINED]:
        if any(h.kind == "torque_order" for h in each.hypotheses):
            # noise and friction of the columns in the new order
            refined.append(
                case.corrected_reading(each.hypotheses, each.log_odds, each.kind)
            )
        else:
            refined.append(case.reevaluated_reading(each))
    if not case.motion_known:
        refined += gravity_readings(case)
    return [*refined, scale_reading(case)]


def _threshold_verdict(case: TorqueCase, ranked: list[LogReading]) -> TorqueVerdict:
    """Verdict by thresholds on residuals, on plausible bodies and on the evidence margin.

    Args:
        case: Joint torques of a log, with robot and prior.
        ranked: All interpretations, the likeliest first.
    """
    as_given = next(each for each in ranked if not each.hypotheses)
    live = case.usable_channels
    implausible = not is_possible(case, as_given)
    acceptable = as_given.relative_rms(live) < MAX_TOTAL_RESIDUAL and not implausible
    accepted, rejected = [], []
    for each in ranked:
        if not each.hypotheses or each.log_posterior < as_given.log_posterior:
            continue
        reasons = tuple(_reasons(case, as_given, each, implausible=implausible))
        final = None if reasons else _final_reading(case, each)
        if final is None:
            rejected.append(Rejected(each, reasons or (DISAGREEMENT_REASON,)))
        else:
            accepted.append(final)
    verdict = TorqueVerdict(
        "not explained",
        case,
        rejected_readings=tuple(rejected[:MAX_PAIR_STARTS]),
        ranked_readings=tuple(ranked),
    )
    if not accepted:
        unmodelled = any(
            _reveals_unmodelled_error(case, as_given, each) for each, _ in rejected
        )
        return (
            replace(verdict, outcome="as given")
            if acceptable and not unmodelled
            else verdict
        )
    best = accepted[0]
    if any(
        each.log_posterior > best.log_posterior + 2 * MIN_EVIDENCE_RATIO
        and not is_possible(case, each)
        for each, _ in rejected
    ):
        return verdict
    if best.log_posterior - as_given.log_posterior < MIN_EVIDENCE_RATIO and acceptable:
        return replace(verdict, outcome="as given")
    small_gain = [each for each, reasons in rejected if reasons == (SMALL_GAIN_REASON,)]
    rivals = [
        each for each in (*accepted[1:], *small_gain) if not are_equivalent(each, best)
    ]
    if best.kind in ("delay", "lag"):
        rivals += [
            each
            for each in ranked
            if each.kind in ("delay", "lag") and not are_equivalent(each, best)
        ]
    equals = [
        each
        for each in rivals
        if best.log_posterior - each.log_posterior < MIN_EVIDENCE_RATIO
    ]
    equal = [each for each in equals if _have_equal_evidence(best, each)]
    if (
        len(equal) < len(equals)
        or best.log_posterior - as_given.log_posterior < MIN_EVIDENCE_RATIO
    ):
        undistinguished = (best, *equals)
        return replace(
            verdict, outcome="not distinguished", equivalent_readings=undistinguished
        )
    return replace(
        verdict,
        outcome="explained",
        readings=(best,),
        equivalent_readings=(best, *equal),
        log_evidence_ratio=best.log_posterior - as_given.log_posterior,
    )


def _have_equal_evidence(one: LogReading, other: LogReading) -> bool:
    """Test whether two interpretations have equal log evidence within 0.5 nats."""
    return abs(one.evidence.log_evidence - other.evidence.log_evidence) < EQUAL_EVIDENCE


def _reveals_unmodelled_error(
    case: TorqueCase, first: LogReading, reading: LogReading
) -> bool:
    """Test whether a rejected interpretation reveals an unmodelled error.

    It does if it is likelier by 40 nats and reduces the rms residual of a channel by a factor of
    1.5.
    """
    if reading.kind in ("delay", "lag"):
        return False  # model errors look like delays
    gain = _relative_rms(case, first) / np.maximum(_relative_rms(case, reading), 1e-6)
    return bool(
        reading.log_posterior > first.log_posterior + 2 * MIN_EVIDENCE_RATIO
        and gain[case.usable_channels].max() > UNMODELLED_IMPROVEMENT
    )


def _final_reading(case: TorqueCase, reading: LogReading) -> LogReading | None:
    """Interpretation with final values and standard deviations; None for inconsistent delays."""
    if reading.kind in DIRECTION_KINDS and reading.sigma.size:
        return rounded_to_axis(with_dispersion(case, reading))
    if reading.kind in ("delay", "lag"):
        signals = case.signals
        seconds = (
            signals.sample_indices[-1] - signals.sample_indices[0]
        ) / signals.rate
        if seconds <= 0.9 * MIN_DELAY_DURATION:
            return None  # model errors look like delays
        delay = common_delay(case, reading)
        if not delay.is_significant:
            return None
        hypothesis = Hypothesis("delay", (), (round(delay.value, 5),))
        return replace(reading, hypotheses=(hypothesis,), sigma=np.array([delay.sigma]))
    return reading


def _reasons(
    case: TorqueCase, first: LogReading, reading: LogReading, *, implausible: bool
) -> list[str]:
    """Reasons to reject an interpretation; empty if it is acceptable.

    Args:
        case: Joint torques of a log, with robot and prior.
        first: Interpretation of the log as given.
        reading: Candidate interpretation.
        implausible: True if the log as given implies impossible bodies or friction.
    """
    live, is_delay = case.usable_channels, reading.kind in ("delay", "lag")
    reasons = []
    if not is_possible(case, reading):
        reasons.append("it needs masses or friction that the robot cannot have")
    if reading.kind == "torque sizes":
        logs = np.log(reading.hypotheses[0].values)
        if not has_contradictory_scales(reading) or abs(logs[live].mean()) > np.log(
            MAX_TORQUE_SCALE
        ):
            reasons.append("all torques would be on another scale")
    if reading.relative_rms(live) > MAX_TOTAL_RESIDUAL:
        reasons.append(f"it leaves {reading.relative_rms(live):.0%} of the torques")
    after = _relative_rms(case, reading)[live]
    gain = _relative_rms(case, first)[live] / np.maximum(after, 1e-6)
    counted = case.signals.valid.sum(axis=0)[live] / case.inflation[live]
    nats = counted * np.log(gain)
    most_improved = int(nats.argmax())
    if not implausible and not is_delay:
        if gain[most_improved] < MIN_IMPROVEMENT:
            reasons.append(SMALL_GAIN_REASON)
        elif after[most_improved] > MAX_CHANNEL_RESIDUAL:
            reasons.append(
                f"it leaves {after[most_improved]:.0%} of the torque that gains most"
            )
    has_loss = -nats.min() > MAX_LOSS_SHARE * nats[nats > 0].sum()
    if has_loss and 1 / gain[nats.argmin()] > MIN_IMPROVEMENT and not implausible:
        reasons.append("another joint's torque is explained worse")
    if reading.kind in ("tilt", "inclined") and not _direction_differs(case, reading):
        reasons.append("it is within three sigmas of what is given")
    return reasons


def _direction_differs(case: TorqueCase, reading: LogReading) -> bool:
    """Test whether gravity differs from its stated direction by more than 3 standard deviations."""
    if not case.gravity.any():
        return True
    cosine = reading.gravity @ case.gravity / case.gravity_magnitude**2
    angle = np.arccos(np.clip(cosine, -1, 1))
    return bool(angle > DIRECTION_Z_THRESHOLD * reading.sigma.max(initial=0.0))


def is_possible(case: TorqueCase, reading: LogReading) -> bool:
    """Test whether friction is dissipative and masses are near the model file's masses.

    Masses are near if they deviate by less than 5 prior standard deviations, and by an rms below 2.

    Args:
        case: Joint torques of a log, with robot and prior.
        reading: Interpretation of the log.
    """
    values, sigma = friction_coefficients(reading.evidence)
    is_dissipative = values.sum(axis=1) > -np.maximum(
        MAX_DRIVING_FRICTION, FRICTION_Z_THRESHOLD * sigma.max(axis=1)
    )
    if not is_dissipative[case.usable_channels].all():
        return False
    if case.motion_known or not case.prior.mean.any():
        return True
    z = reading.products.basis @ reading.evidence.shared_mean
    deviations = case.prior.mass_deviations(z)
    rms = np.sqrt((deviations**2).mean())
    return bool(np.abs(deviations).max() < MAX_MASS_DEVIATION and rms < MAX_MASS_RMS)


def _relative_rms(case: TorqueCase, reading: LogReading) -> Array:
    """Relative rms residual of each of the C recorded torque columns, (C,)."""
    squares = reading.evidence.residual_squares.copy()
    column = np.arange(case.tree.n)
    for each in reading.hypotheses:
        if each.kind == "torque_order":
            column = np.array(each.values)
    by_column = np.empty_like(squares)
    by_column[column] = squares
    square_sums = (case.signals.valid * case.signals.torque**2).sum(axis=0)
    return np.asarray(
        np.sqrt(np.maximum(by_column, 1e-12) / np.maximum(square_sums, 1e-12))
    )


def are_equivalent(one: LogReading, other: LogReading) -> bool:
    """Test whether two interpretations agree (gravity within 5 deg) or one contains the other.

    Args:
        one: First interpretation.
        other: Second interpretation.
    """
    kinds = {one.kind, other.kind}
    if kinds <= {"no gravity", "part of gravity"} or kinds <= {"delay", "lag"}:
        return True
    if kinds <= {*DIRECTION_KINDS}:
        sizes = np.linalg.norm(one.gravity) * np.linalg.norm(other.gravity)
        return bool(one.gravity @ other.gravity > EQUAL_DIRECTION_COSINE * sizes)
    return one.hypotheses == other.hypotheses
