"""Raw signals held against themselves and against the joints' limits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.arrays import Array
from testbed.diagnostics.diagnostic import Diagnostic, diagnose
from testbed.identification.estimate import Estimate
from testbed.identification.survey import Repeats, Survey
from testbed.robot.tree import Joint, Tree

OUTSIDE = 0.02
"""Part of a joint's range by which encoders may leave it."""

STILL = {"revolute": 0.02, "prismatic": 0.002}
"""Ranges within which a joint hardly moves [rad, m]."""

BEYOND_EFFORT = 2.0
"""Times the motor's greatest effort that no torque reaches."""

PILED = 0.01
"""Part of the samples at one extreme value that is saturation."""

CLIFF = 5.0
"""Times as many samples as at the next value that are at the extreme one if it is a stop."""


FEW_REPEATS = 5
"""Repeated samples that may be chance."""

TOGETHER = 10.0
"""Times as often as channels one by one that samples are repeated if it is no chance."""


def signal_diagnostics(estimate: Estimate, tree: Tree, survey: Survey) -> Iterator[Diagnostic]:
    """Encoders outside their joints' ranges, dead and saturated channels, impossible torques.

    Args:
        estimate: Made from the recording.
        tree: The robot; its joints' limits are read.
        survey: Some of the raw samples.
    """
    yield from _encoders(tree, survey.position)
    yield from _channels(estimate, survey.measured)
    yield from _repeated(estimate, survey.repeats)
    if estimate.method == "internal":
        yield from _efforts(tree, survey.measured)


def _repeated(estimate: Estimate, repeats: Repeats) -> Iterator[Diagnostic]:
    """Samples in which all channels are what they were before, too often for chance."""
    if not repeats.steps or repeats.together < FEW_REPEATS:
        return
    share = repeats.together / repeats.steps
    by_chance = float(np.prod(repeats.channels / repeats.steps))
    if share > TOGETHER * by_chance:
        yield diagnose(
            "channel.repeated",
            "the plate's samples" if estimate.method == "external" else "the torques' samples",
            share,
            method=estimate.method,
            count=repeats.together,
            steps=repeats.steps,
        )


def _encoders(tree: Tree, position: Array) -> Iterator[Diagnostic]:
    """Positions that the joint cannot have, or that hardly change."""
    for joint, q in zip(tree.joints, position.T, strict=True):
        unit, subject = "rad" if joint.revolute else "m", f"the encoder of '{joint.name}'"
        low, high = float(q.min()), float(q.max())
        least, greatest = joint.position_range
        room = OUTSIDE * (greatest - least) if np.isfinite(greatest - least) else 0.0
        if low < least - room or high > greatest + room:
            yield diagnose(
                "encoder.range",
                subject,
                max(least - low, high - greatest),
                causes=_encoder_causes(joint, low, high),
                low=low,
                high=high,
                least=least,
                greatest=greatest,
                unit=unit,
            )
        elif high - low < STILL[joint.kind]:
            yield diagnose("encoder.still", subject, high - low, unit=unit)


def _encoder_causes(joint: Joint, low: float, high: float) -> list[str]:
    """The likeliest first, by what would bring the positions into the joint's range."""
    least, greatest = joint.position_range
    factor = 180 / np.pi if joint.revolute else 1000.0
    converted = least <= low / factor and high / factor <= greatest
    converted &= high - low > greatest - least
    negated = least <= -high and -low <= greatest
    unit = "degrees" if joint.revolute else "millimetres"
    causes = ((converted, unit), (negated, "sign"), (not converted, "zero"),
              (True, "encoder-of-another-joint"), (not converted, unit))  # fmt: skip
    return [cause for holds, cause in causes if holds]


def _channels(estimate: Estimate, measured: Array) -> Iterator[Diagnostic]:
    """Signals that stop at a value, or never leave it."""
    for c, values in enumerate(measured.T):
        unit, label, method = estimate.channel_units[c], estimate.label(c), estimate.method
        if np.ptp(values) == 0:
            if estimate.matters[c]:
                yield diagnose("channel.constant", label, values[0], method=method, unit=unit)
            continue
        share, end = max((_piled(values, float(e)), float(e)) for e in (values.max(), values.min()))
        if share > PILED:
            yield diagnose("channel.saturated", label, share, method=method, end=end, unit=unit)


def _piled(values: Array, end: float) -> float:
    """Part of the samples at an extreme value, if that is a stop and no crest."""
    distance = np.abs(values - end)
    away = distance[distance > 0]
    beside = int((away == away.min()).sum())
    here = len(values) - len(away)
    return here / len(values) if here > CLIFF * beside else 0.0


def _efforts(tree: Tree, torque: Array) -> Iterator[Diagnostic]:
    """Torques that no motor of the robot has."""
    for joint, values in zip(tree.joints, torque.T, strict=True):
        most = float(np.abs(values).max())
        if most > BEYOND_EFFORT * joint.max_effort:
            causes = ["torque-of-another-joint", "raw-units"]
            yield diagnose(
                "torque.effort",
                f"the torque of '{joint.name}'",
                most / joint.max_effort,
                method="internal",
                causes=["torques-in-n-mm"] * joint.revolute + causes,
                most=most,
                effort=joint.max_effort,
                unit="N m" if joint.revolute else "N",
            )
