"""Which reading of a log of torques may be said: the gate between evidence and words.

A reading is said where it leaves what a right one leaves, needs bodies that the robot can have, and
is far likelier than all others that say something else; else there is no word.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.importing.check.delay_readings import (
    SHORTEST,
    common_delay,
    delay_readings,
)
from testbed.importing.check.gravity_readings import (
    AXES,
    gravity_readings,
    on_axis,
    with_dispersion,
)
from testbed.importing.check.position_readings import position_readings
from testbed.importing.check.remedies import Hypothesis
from testbed.importing.check.spring_readings import spring_readings
from testbed.importing.check.torque_columns import (
    column_readings,
    contradictory,
    size_reading,
    without_file_gravity,
)
from testbed.importing.check.torque_products import friction
from testbed.importing.check.torque_readings import LogReading, TorqueCase

MARGIN = 20.0
"""Nats over the likeliest reading that says something else."""

ALIKE = 0.5
"""Nats between readings that are one in the data."""

LEFT, LEFT_OF_ALL = 0.30, 0.15
"""Rms that may be left of the channel that gains most, and of all torques: right readings leave
1.6 % of all (median), 4 % (99 %), of real logs 1 to 10 %."""

FAINT = "no joint's torque is explained clearly better"
DISAGREE = "the joints do not agree on it"

BETTER, LOSS = 1.25, 0.2
"""Times less that a reading leaves in some channel, or more in any; part of what the channels gain
that one of them may lose."""

HEAVIEST, MASSES = 5.0, 2.0
"""Sigmas of the model file by which one mass, and the masses' rms, may be off."""

LARGEST = 2.5
"""Times that torques may be too large, or too small, by all masses."""

DRIVEN, SIGMAS = 0.15, 3.0
"""Part of a torque, and standard deviations, by which friction may drive a joint."""

ODD = 1.5
"""Times less, in some channel, that an impossible reading leaves where something has no name."""

BEYOND = 3.0
"""Sigmas from which a direction is another one."""

KEPT, TRIED, STEPS = 14, 3, 3
"""Readings judged again; tried as the first of two; and most mistakes one after another."""

NEAR = np.cos(np.deg2rad(5))
"""Cosine of directions that say the same."""

DIRECTIONS = ("tilt", "inclined", *AXES)
"""Families of gravity's directions."""

TERMINAL = ("no gravity", "part of gravity", "by file")
"""Families after which no second mistake is looked for."""

Outcome = Literal["as given", "explained", "not distinguished", "not explained"]


class Rejected(NamedTuple):
    """Rejected reading, likelier than the log as given, with the reasons."""

    reading: LogReading
    reasons: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class TorqueVerdict:
    """Result of model comparison for a log of torques.

    Attributes:
        outcome: Whether it is right as given, explained by readings, or neither.
        case: The log as it was judged last.
        readings: Those that explain it, applied one after another.
        equals: Readings that explain it as well, the likeliest first.
        attempts: The likeliest readings that are not said.
        ranked: All readings, the likeliest first.
        nats: By how much the reading that is said is likelier than the log as given.
    """

    outcome: Outcome
    case: TorqueCase
    readings: tuple[LogReading, ...] = ()
    equals: tuple[LogReading, ...] = ()
    attempts: tuple[Rejected, ...] = ()
    ranked: tuple[LogReading, ...] = ()
    nats: float = 0.0

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Hypotheses of all accepted readings."""
        return tuple(h for each in self.readings for h in each.hypotheses)


def explain(case: TorqueCase, steps: int = STEPS) -> TorqueVerdict:
    """Compare readings of a log, correcting up to a few mistakes one by one.

    Args:
        case: The log.
        steps: Most mistakes.
    """
    verdict = judge(case)
    if verdict.outcome == "as given" or steps == 1:
        return verdict
    if verdict.outcome == "explained":
        return _continued(verdict, steps)
    if verdict.outcome == "not distinguished" or not verdict.attempts:
        return verdict
    return _first_of_two(verdict)


def _continued(verdict: TorqueVerdict, steps: int) -> TorqueVerdict:
    """Verdict on the corrected log, joined with the first accepted reading."""
    (reading,) = verdict.readings
    if reading.kind in TERMINAL:
        return verdict
    rest = explain(without_mistake(verdict.case, reading), steps - 1)
    again = reading.kind in [each.kind for each in rest.readings]
    again = again and reading.kind not in (*DIRECTIONS, "spring")
    if rest.outcome == "not explained" or again:
        return replace(verdict, outcome="not explained", readings=())
    if rest.outcome != "explained":
        return replace(verdict, ranked=rest.ranked)
    return replace(
        rest, readings=(reading, *rest.readings), nats=verdict.nats + rest.nats
    )


def _first_of_two(verdict: TorqueVerdict) -> TorqueVerdict:
    """Search for pairs of mistakes, beginning with the likeliest readings."""
    case, candidates = verdict.case, list[LogReading]()
    for each in verdict.ranked[:12]:
        other = all(each.kind != known.kind for known in candidates)
        if each.kind == "torque sizes" and not contradictory(each):
            continue
        if each.hypotheses and other and each.kind not in TERMINAL:
            candidates.append(each)
    pairs = []
    for each in candidates[:TRIED]:
        then = judge(without_mistake(case, each))
        if then.outcome == "explained":
            pairs.append((then.readings[0].log + each.odds, each, then.readings[0]))
    pairs.sort(key=lambda pair: -pair[0])
    if not pairs:
        return verdict
    if len(pairs) > 1:
        kinds = [{first.kind, second.kind} for _, first, second in pairs[:2]]
        if pairs[0][0] - pairs[1][0] < MARGIN and kinds[0] != kinds[1]:
            return verdict
    _, first, second = pairs[0]
    if (
        judge(without_mistake(without_mistake(case, first), second)).outcome
        != "as given"
    ):
        return verdict
    return replace(verdict, outcome="explained", readings=(first, second), attempts=())


def without_mistake(case: TorqueCase, reading: LogReading) -> TorqueCase:
    """Case with signals, gravity and springs corrected by a reading.

    Args:
        case: The log.
        reading: Of it.
    """
    signals = case.signals.corrected(*reading.hypotheses)
    springs = [each.joints for each in reading.hypotheses if each.kind == "spring"]
    return replace(
        case,
        signals=signals,
        gravity=reading.gravity,
        inflation=np.ones(case.tree.n),
        sprung=(*case.sprung, *(joint for each in springs for joint in each)),
    )


def judge(case: TorqueCase) -> TorqueVerdict:
    """Compare all single readings of a log, and accept at most one.

    Args:
        case: The log.
    """
    joints = np.flatnonzero(case.live).tolist()
    if not joints:
        return TorqueVerdict("as given", case)
    readings = [case.as_given, *column_readings(case, joints)]
    if not case.fixed:
        readings += gravity_readings(case)
        readings += without_file_gravity(case)
        readings += position_readings(case, joints)
    readings += spring_readings(case, joints)
    readings += delay_readings(case)
    case = case.with_inflation(max(readings, key=lambda each: each.log))
    ranked = sorted(_refined(case, readings), key=lambda each: -each.log)
    return _gate(case, ranked)


def _refined(case: TorqueCase, readings: Sequence[LogReading]) -> list[LogReading]:
    """Likeliest readings, re-evaluated with residual autocorrelation."""
    directions = [*DIRECTIONS, "part of gravity"]
    others = [each for each in readings[1:] if each.kind not in directions]
    others.sort(key=lambda each: -each.log)
    refined = [case.as_given]
    for each in others[:KEPT]:
        if any(h.kind == "torque_order" for h in each.hypotheses):
            # with noise and friction of the columns as they then are
            refined.append(case.corrected(each.hypotheses, each.odds, each.kind))
        else:
            refined.append(case.again(each))
    if not case.fixed:
        refined += gravity_readings(case)
    return [*refined, size_reading(case)]


def _gate(case: TorqueCase, ranked: list[LogReading]) -> TorqueVerdict:
    """Verdict by thresholds on fit, possible bodies and evidence margin."""
    first = next(each for each in ranked if not each.hypotheses)
    live = case.live
    absurd = not possible(case, first)
    fine = first.pooled(live) < LEFT_OF_ALL and not absurd
    good, rejected = [], []
    for each in ranked:
        if not each.hypotheses or each.log < first.log:
            continue
        reasons = tuple(_reasons(case, first, each, absurd=absurd))
        measured = None if reasons else _measured(case, each)
        if measured is None:
            rejected.append(Rejected(each, reasons or (DISAGREE,)))
        else:
            good.append(measured)
    verdict = TorqueVerdict(
        "not explained", case, attempts=tuple(rejected[:TRIED]), ranked=tuple(ranked)
    )
    if not good:
        odd = any(_unnamed(case, first, each) for each, _ in rejected)
        return replace(verdict, outcome="as given") if fine and not odd else verdict
    best = good[0]
    if any(
        each.log > best.log + 2 * MARGIN and not possible(case, each)
        for each, _ in rejected
    ):
        return verdict
    if best.log - first.log < MARGIN and fine:
        return replace(verdict, outcome="as given")
    faint = [each for each, reasons in rejected if reasons == (FAINT,)]
    rivals = [each for each in (*good[1:], *faint) if not same(each, best)]
    if best.kind in ("delay", "lag"):
        rivals += [
            each
            for each in ranked
            if each.kind in ("delay", "lag") and not same(each, best)
        ]
    equals = [each for each in rivals if best.log - each.log < MARGIN]
    alike = [each for each in equals if _alike(best, each)]
    if len(alike) < len(equals) or best.log - first.log < MARGIN:
        said = (best, *equals)
        return replace(verdict, outcome="not distinguished", equals=said)
    return replace(
        verdict,
        outcome="explained",
        readings=(best,),
        equals=(best, *alike),
        nats=best.log - first.log,
    )


def _alike(one: LogReading, other: LogReading) -> bool:
    """Whether two readings have the same evidence."""
    return abs(one.evidence.log - other.evidence.log) < ALIKE


def _unnamed(case: TorqueCase, first: LogReading, reading: LogReading) -> bool:
    """Whether a rejected reading reveals an unmodelled error."""
    if reading.kind in ("delay", "lag"):
        return False  # errors of models look late
    gain = _left(case, first) / np.maximum(_left(case, reading), 1e-6)
    return bool(reading.log > first.log + 2 * MARGIN and gain[case.live].max() > ODD)


def _measured(case: TorqueCase, reading: LogReading) -> LogReading | None:
    """A reading with its final values and sigmas; None for a delay that joints do not share."""
    if reading.kind in DIRECTIONS and reading.sigma.size:
        return on_axis(with_dispersion(case, reading))
    if reading.kind in ("delay", "lag"):
        signals = case.signals
        seconds = (signals.at[-1] - signals.at[0]) / signals.rate
        if seconds <= 0.9 * SHORTEST:
            return None  # errors of models look like delays
        delay = common_delay(case, reading)
        if not delay.agree:
            return None
        late = Hypothesis("delay", (), (round(delay.value, 5),))
        return replace(reading, hypotheses=(late,), sigma=np.array([delay.sigma]))
    return reading


def _reasons(
    case: TorqueCase, first: LogReading, reading: LogReading, *, absurd: bool
) -> list[str]:
    """Reasons to reject a reading; empty for an acceptable one."""
    live, late = case.live, reading.kind in ("delay", "lag")
    reasons = []
    if not possible(case, reading):
        reasons.append("it needs masses or friction that the robot cannot have")
    if reading.kind == "torque sizes":
        logs = np.log(reading.hypotheses[0].values)
        if not contradictory(reading) or abs(logs[live].mean()) > np.log(LARGEST):
            reasons.append("all torques would be of another size")
    if reading.pooled(live) > LEFT_OF_ALL:
        reasons.append(f"it leaves {reading.pooled(live):.0%} of the torques")
    after = _left(case, reading)[live]
    gain = _left(case, first)[live] / np.maximum(after, 1e-6)
    counted = case.signals.counted.sum(axis=0)[live] / case.inflation[live]
    nats = counted * np.log(gain)
    top = int(nats.argmax())
    if not absurd and not late:
        if gain[top] < BETTER:
            reasons.append(FAINT)
        elif after[top] > LEFT:
            reasons.append(f"it leaves {after[top]:.0%} of the torque that gains most")
    loses = -nats.min() > LOSS * nats[nats > 0].sum()
    if loses and 1 / gain[nats.argmin()] > BETTER and not absurd:
        reasons.append("another joint's torque is explained worse")
    if reading.kind in ("tilt", "inclined") and not _turned(case, reading):
        reasons.append("it is within three sigmas of what is given")
    return reasons


def _turned(case: TorqueCase, reading: LogReading) -> bool:
    """Whether gravity's direction differs significantly from the stated one."""
    if not case.gravity.any():
        return True
    cosine = reading.gravity @ case.gravity / case.standard**2
    angle = np.arccos(np.clip(cosine, -1, 1))
    return bool(angle > BEYOND * reading.sigma.max(initial=0.0))


def possible(case: TorqueCase, reading: LogReading) -> bool:
    """Whether friction is dissipative and masses are near the model file's.

    Args:
        case: The log.
        reading: Of it.
    """
    values, sigma = friction(reading.evidence)
    brakes = values.sum(axis=1) > -np.maximum(DRIVEN, SIGMAS * sigma.max(axis=1))
    if not brakes[case.live].all():
        return False
    if case.fixed or not case.prior.mean.any():
        return True
    z = reading.products.basis @ reading.evidence.shared
    deviations = case.prior.mass_deviations(z)
    rms = np.sqrt((deviations**2).mean())
    return bool(np.abs(deviations).max() < HEAVIEST and rms < MASSES)


def _left(case: TorqueCase, reading: LogReading) -> Array:
    """Relative rms residual of each recorded torque column, (C,)."""
    left = reading.evidence.residual.copy()
    column = np.arange(case.tree.n)
    for each in reading.hypotheses:
        if each.kind == "torque_order":
            column = np.array(each.values)
    by_column = np.empty_like(left)
    by_column[column] = left
    whole = (case.signals.counted * case.signals.torque**2).sum(axis=0)
    return np.asarray(np.sqrt(np.maximum(by_column, 1e-12) / np.maximum(whole, 1e-12)))


def same(one: LogReading, other: LogReading) -> bool:
    """Whether two readings are equal, or one contains the other.

    Args:
        one: A reading.
        other: Another.
    """
    kinds = {one.kind, other.kind}
    if kinds <= {"no gravity", "part of gravity"} or kinds <= {"delay", "lag"}:
        return True
    if kinds <= {*DIRECTIONS}:
        sizes = np.linalg.norm(one.gravity) * np.linalg.norm(other.gravity)
        return bool(one.gravity @ other.gravity > NEAR * sizes)
    return one.hypotheses == other.hypotheses
