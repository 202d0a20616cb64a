"""Raw signals held against themselves and against the joints' limits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.arrays import Array
from testbed.identification.estimate import Estimate
from testbed.identification.finding import Finding
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


def signal_findings(estimate: Estimate, tree: Tree, survey: Survey) -> list[Finding]:
    """Encoders outside their joints' ranges, dead and saturated channels, impossible torques.

    Args:
        estimate: Made from the recording.
        tree: The robot; its joints' limits are read.
        survey: Some of the raw samples.
    """
    found = [*_encoders(tree, survey.position), *_channels(estimate, survey.measured)]
    found += _repeated(estimate, survey.repeats)
    if estimate.method == "internal":
        found += _efforts(tree, survey.measured)
    return found


def _repeated(estimate: Estimate, repeats: Repeats) -> Iterator[Finding]:
    """Samples in which all channels are what they were before, too often for chance."""
    if not repeats.steps or repeats.together < FEW_REPEATS:
        return
    share = repeats.together / repeats.steps
    by_chance = float(np.prod(repeats.channels / repeats.steps))
    if share > TOGETHER * by_chance:
        what = "the plate's samples" if estimate.method == "external" else "the torques' samples"
        yield Finding(
            what,
            f"repeat the ones before while the robot moves ({repeats.together} of "
            f"{repeats.steps}, all channels together)",
            share,
            ("samples lost on the way and filled with the last", "a device slower than the others"),
            "record at the slowest device's rate, and look for losses on the bus",
            code="repeated-samples",
            method=estimate.method,
        )


def _encoders(tree: Tree, position: Array) -> Iterator[Finding]:
    """Positions that the joint cannot have, or that hardly change."""
    for joint, q in zip(tree.joints, position.T, strict=True):
        unit = "rad" if joint.revolute else "m"
        low, high = float(q.min()), float(q.max())
        least, greatest = joint.position_range
        room = OUTSIDE * (greatest - least) if np.isfinite(greatest - least) else 0.0
        if low < least - room or high > greatest + room:
            yield Finding(
                f"the encoder of '{joint.name}'",
                f"reads {low:.4g} to {high:.4g} {unit}, the joint's range is {least:.4g} to "
                f"{greatest:.4g} {unit}",
                max(least - low, high - greatest),
                _encoder_causes(joint, low, high),
                "convert the positions, or correct the range in the model file",
                code="encoder-range",
            )
        elif high - low < STILL[joint.kind]:
            yield Finding(
                f"the encoder of '{joint.name}'",
                f"moves by only {high - low:.2g} {unit}",
                high - low,
                ("the joint did not move", f"a unit other than {unit}"),
                "move the joint: its parameters cannot be told otherwise",
                code="joint-at-rest",
                alone=True,
            )


def _encoder_causes(joint: Joint, low: float, high: float) -> tuple[str, ...]:
    """The likeliest first, by what would bring the positions into the joint's range."""
    least, greatest = joint.position_range
    factor = 180 / np.pi if joint.revolute else 1000.0
    converted = least <= low / factor and high / factor <= greatest
    converted &= high - low > greatest - least
    negated = least <= -high and -low <= greatest
    unit = "degrees instead of rad" if joint.revolute else "mm instead of m"
    causes = (
        (converted, unit),
        (negated, "the opposite sign"),
        (not converted, "another zero"),
        (True, "the encoder of another joint"),
        (not converted, unit),
    )
    return tuple(cause for holds, cause in causes if holds)


def _channels(estimate: Estimate, measured: Array) -> Iterator[Finding]:
    """Signals that stop at a value, or never leave it."""
    for c, values in enumerate(measured.T):
        unit = estimate.channel_units[c]
        if np.ptp(values) == 0:
            if estimate.matters[c]:
                yield Finding(
                    estimate.label(c),
                    f"is always {values[0]:.4g} {unit}, which the motion does not allow",
                    float(values[0]),
                    ("it is not connected", "a column that was filled in"),
                    "record it, or weigh it with 0 (`fit`)",
                    code="constant-channel",
                    method=estimate.method,
                )
            continue
        share, end = max((_piled(values, float(e)), float(e)) for e in (values.max(), values.min()))
        if share > PILED:
            yield Finding(
                estimate.label(c),
                f"stays at its extreme value {end:.4g} {unit} in {share:.1%} of the samples",
                share,
                ("the sensor or its amplifier is saturated", "the drive is at its limit"),
                "measure with a wider range, or move less",
                code="saturation",
                method=estimate.method,
            )


def _piled(values: Array, end: float) -> float:
    """Part of the samples at an extreme value, if that is a stop and no crest."""
    distance = np.abs(values - end)
    away = distance[distance > 0]
    beside = int((away == away.min()).sum())
    here = len(values) - len(away)
    return here / len(values) if here > CLIFF * beside else 0.0


def _efforts(tree: Tree, torque: Array) -> Iterator[Finding]:
    """Torques that no motor of the robot has."""
    for joint, values in zip(tree.joints, torque.T, strict=True):
        unit = "N m" if joint.revolute else "N"
        most = float(np.abs(values).max())
        if most > BEYOND_EFFORT * joint.max_effort:
            yield Finding(
                f"the torque of '{joint.name}'",
                f"reaches {most:.4g} {unit}, the joint's greatest effort is "
                f"{joint.max_effort:.4g} {unit}",
                most / joint.max_effort,
                ("N mm instead of N m", "the torque of another joint", "raw units of the drive")
                if joint.revolute
                else ("the force of another joint", "raw units of the drive"),
                "convert the torques, or correct the effort in the model file",
                code="effort",
                method="internal",
            )
