"""Readings with positions of other zeros, senses, units, or in another order of joints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.importing.check.remedies import (
    BEYOND,
    LITTLE,
    QUARTERS,
    Hypothesis,
    orders,
    own_joints,
)
from testbed.importing.check.torque_readings import SCREENED, LogReading, TorqueCase

UNIT, ZERO, REVERSED, SENSE, EXCHANGED = -2.0, -5.0, -5.0, -5.0, -6.0
"""Logarithms of prior odds: of degrees taken for radians, of another zero, of a joint that is
reversed in all signals or in its position alone, of two that are exchanged [nats]."""

PINNED = -8.0
"""Of another order or sense of positions that measured velocities bear out [nats]."""

HEAVY = 0.1
"""Part of the robot's mass of a last body whose zero matters beside the model file."""

BEST = 6
"""Readings that are judged by all instants, the likeliest by few."""


def position_readings(case: TorqueCase, joints: Sequence[int]) -> Iterator[LogReading]:
    """Yield the likeliest readings with other joint positions.

    Args:
        case: The log.
        joints: Indices of those with torques that count.
    """
    readings = [
        case.corrected(hypotheses, odds, kind, SCREENED)
        for hypotheses, odds, kind in _hypotheses(case, joints)
    ]
    readings.sort(key=lambda each: -each.log)
    for each in readings[:BEST]:
        yield case.corrected(each.hypotheses, each.odds, each.kind)


def _hypotheses(
    case: TorqueCase, joints: Sequence[int]
) -> Iterator[tuple[tuple[Hypothesis, ...], float, str]]:
    """Yield position hypotheses, their log prior odds [nats], and their family."""
    tree, q = case.tree, case.signals.q
    turning = [k for k in own_joints(tree) if tree.joints[k].revolute]
    if turning and np.abs(q[:, turning]).max() > BEYOND:
        yield (Hypothesis("degrees", tuple(turning)),), UNIT, "unit"
    if turning and np.ptp(q[:, turning], axis=0).max() < LITTLE:
        yield (Hypothesis("radians", tuple(turning)),), UNIT, "unit"
    if case.large:
        return
    pinned = PINNED if case.signals.pinned else 0.0
    for joint in joints:
        sign = Hypothesis("position_sign", (joint,))
        both = (sign, Hypothesis("torque_sign", (joint,)))
        yield both, REVERSED, "joint reversed"
        yield (sign,), SENSE, "position sign"
    total = sum(each.mass for each in tree.inertias)
    for joint in turning:
        light = tree.inertias[joint].mass < HEAVY * total
        if (light and not tree.children(joint)) or tree.parents[joint] < 0:
            continue  # zeros that rename parameters, or the base's direction
        for angle in QUARTERS:
            yield (Hypothesis("zero", (joint,), (angle,)),), ZERO, "zero"
    for order in orders(own_joints(tree)):
        moved = tuple(k for k, other in enumerate(order) if k != other)
        if any(tree.joints[k].kind != tree.joints[order[k]].kind for k in moved):
            continue
        if set(moved) & set(joints):
            position = Hypothesis("position_order", moved, order)
            torque = Hypothesis("torque_order", moved, order)
            yield (position, torque), EXCHANGED, "joint order"
            yield (position,), EXCHANGED + pinned, "position order"
