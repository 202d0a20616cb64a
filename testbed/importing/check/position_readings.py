"""Interpretations of a log with other position zeros, signs, units or joint order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.importing.check.remedies import (
    DEGREES_THRESHOLD,
    RADIANS_THRESHOLD,
    USUAL_ZERO_OFFSETS,
    Hypothesis,
    candidate_orders,
    joints_without_free_base,
)
from testbed.importing.check.torque_readings import (
    SCREENING_INSTANTS,
    LogReading,
    TorqueCase,
)

(
    UNIT_LOG_ODDS,
    ZERO_LOG_ODDS,
    REVERSED_JOINT_LOG_ODDS,
    SIGN_LOG_ODDS,
    EXCHANGE_LOG_ODDS,
) = -2.0, -5.0, -5.0, -5.0, -6.0
"""Log prior odds: degrees taken for radians, another zero, a joint reversed in all signals, a joint
reversed in its position alone, two joints exchanged [nats]."""

MEASURED_VELOCITY_LOG_ODDS = -8.0
"""Additional log prior odds of another order of positions if measured velocities have the stated
order [nats]."""

MIN_MASS_SHARE = 0.1
"""Least mass of an end body, relative to the robot's mass, for hypotheses on the zero of its joint.
"""

MAX_READINGS = 6
"""Number of readings that are evaluated at all instants: the likeliest by few instants."""


def position_readings(case: TorqueCase, joints: Sequence[int]) -> Iterator[LogReading]:
    """Yield likeliest interpretations with other position units, signs, zeros or joint orders.

    The interpretations with the six largest log posteriors at 80 instants are evaluated at all
    instants, in decreasing order of these log posteriors.

    Args:
        case: Joint torques of a log, with robot and prior.
        joints: Indices of the joints with usable torques.
    """
    readings = [
        case.corrected_reading(hypotheses, odds, kind, SCREENING_INSTANTS)
        for hypotheses, odds, kind in _position_hypotheses(case, joints)
    ]
    readings.sort(key=lambda each: -each.log_posterior)
    for each in readings[:MAX_READINGS]:
        yield case.corrected_reading(each.hypotheses, each.log_odds, each.kind)


def _position_hypotheses(
    case: TorqueCase, joints: Sequence[int]
) -> Iterator[tuple[tuple[Hypothesis, ...], float, str]]:
    """Yield hypotheses on positions, with log prior odds [nats] and name of their category.

    They are: degrees and radians confused; signs, of the position alone or of the torque too; zeros
    shifted by 90 or 180 deg; joint orders, of the positions alone or of the torques too. For robots
    with many joints, only units are tested.
    """
    tree, q = case.tree, case.signals.q
    turning = [k for k in joints_without_free_base(tree) if tree.joints[k].revolute]
    if turning and np.abs(q[:, turning]).max() > DEGREES_THRESHOLD:
        yield (Hypothesis("degrees", tuple(turning)),), UNIT_LOG_ODDS, "unit"
    if turning and np.ptp(q[:, turning], axis=0).max() < RADIANS_THRESHOLD:
        yield (Hypothesis("radians", tuple(turning)),), UNIT_LOG_ODDS, "unit"
    if case.has_many_joints:
        return
    order_log_odds = (
        MEASURED_VELOCITY_LOG_ODDS if case.signals.has_measured_velocity else 0.0
    )
    for joint in joints:
        sign = Hypothesis("position_sign", (joint,))
        both = (sign, Hypothesis("torque_sign", (joint,)))
        yield both, REVERSED_JOINT_LOG_ODDS, "joint reversed"
        yield (sign,), SIGN_LOG_ODDS, "position sign"
    total = sum(each.mass for each in tree.inertias)
    for joint in turning:
        is_light = tree.inertias[joint].mass < MIN_MASS_SHARE * total
        if (is_light and not tree.children(joint)) or tree.parents[joint] < 0:
            continue  # zeros equivalent to other parameters, or to another direction of the base
        for angle in USUAL_ZERO_OFFSETS:
            yield (Hypothesis("zero", (joint,), (angle,)),), ZERO_LOG_ODDS, "zero"
    for order in candidate_orders(joints_without_free_base(tree)):
        moved = tuple(k for k, other in enumerate(order) if k != other)
        if any(tree.joints[k].kind != tree.joints[order[k]].kind for k in moved):
            continue
        if set(moved) & set(joints):
            position = Hypothesis("position_order", moved, order)
            torque = Hypothesis("torque_order", moved, order)
            yield (position, torque), EXCHANGE_LOG_ODDS, "joint order"
            yield (position,), EXCHANGE_LOG_ODDS + order_log_odds, "position order"
