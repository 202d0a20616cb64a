"""Interpretations of a log with other torque order, sign or scale, or with gravity subtracted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion, joint_forces
from testbed.core.estimation.evidence import ChannelProducts, Evidence
from testbed.importing.check.gravity_readings import (
    DIRECTION_LOG_ODDS,
    GRAVITY_DIRECTIONS,
)
from testbed.importing.check.remedies import (
    Hypothesis,
    candidate_orders,
    joints_without_free_base,
)
from testbed.importing.check.torque_readings import LogReading, TorqueCase

(
    ALL_SIGNS_LOG_ODDS,
    ONE_SIGN_LOG_ODDS,
    EXCHANGE_LOG_ODDS,
    SCALE_LOG_ODDS,
    COMPENSATION_LOG_ODDS,
) = -3.0, -4.0, -5.0, -6.0, -4.0
"""Log prior odds: opposite signs of all torques, of one torque, two torques exchanged, other scale
factors, and the model file's gravity torques subtracted [nats]."""

LOG_SCALE_SIGMA = 0.4
"""Standard deviation of the logarithm of a torque's scale factor."""

MAX_ITERATIONS, MAX_STEP = 6, 0.5
"""Number of Gauss-Newton iterations for scale factors, and largest step of their logarithms."""

Z_THRESHOLD, MIN_LOG_RANGE = 4.0, 0.15
"""Conditions for contradictory scale factors: normalised deviation from the mean, and range of
logarithms. Correct logs reach 2.7 standard deviations and 0.08."""

MAX_SIGMA_RATIO, KNOWN_SIGMA = 2.0, 0.1
"""Conditions for a known scale factor: standard deviation relative to the least, or absolute."""


def torque_order_and_sign_readings(
    case: TorqueCase, joints: Sequence[int]
) -> Iterator[LogReading]:
    """Yield interpretations of the log with torques of other columns or of opposite signs.

    The order is: all signs opposite (also with gravity along other axes), single signs opposite,
    and joint orders. Joint orders are omitted for robots with many joints.

    Args:
        case: Joint torques of a log, with robot and prior.
        joints: Indices of the joints with usable torques.
    """
    torque = case.signals.torque.T
    all_joints = tuple(range(case.tree.n))
    opposite = Hypothesis("torque_sign", all_joints)
    reading = case.with_torques((opposite,), ALL_SIGNS_LOG_ODDS, -torque, "sign of all")
    yield reading
    if not (case.motion_known or case.has_many_joints):
        yield from _opposite_axis_readings(case, reading, -torque)
    for joint in joints:
        sign = np.where(np.arange(len(torque)) == joint, -1.0, 1.0)
        one = Hypothesis("torque_sign", (joint,))
        yield case.with_torques(
            (one,), ONE_SIGN_LOG_ODDS, sign[:, None] * torque, "torque sign"
        )
    if case.has_many_joints:
        return
    for order in candidate_orders(joints_without_free_base(case.tree)):
        moved = tuple(k for k, other in enumerate(order) if k != other)
        if set(moved) & set(joints):
            exchange = Hypothesis("torque_order", moved, order)
            measured = torque[list(order)]
            yield case.with_torques(
                (exchange,), EXCHANGE_LOG_ODDS, measured, "torque order"
            )


def _opposite_axis_readings(
    case: TorqueCase, reading: LogReading, measured: Array
) -> Iterator[LogReading]:
    """Yield interpretations with opposite torque signs and gravity along each other base axis.

    Both changes together resemble the robot as given with reversed friction and inertial torques.

    Args:
        case: Joint torques of a log, with robot and prior.
        reading: Interpretation with opposite torque signs.
        measured: Torques with opposite signs, (C, T), of C channels at T instants.
    """
    for name, axis in GRAVITY_DIRECTIONS.items():
        gravity = axis * case.gravity_magnitude
        if gravity @ case.gravity > 0.99 * case.gravity_magnitude**2:
            continue
        odds = ALL_SIGNS_LOG_ODDS + DIRECTION_LOG_ODDS[name.split()[0]]
        estimate = case.fit(reading.products, gravity, measured)
        value = tuple(gravity.tolist())
        yield replace(
            reading,
            hypotheses=(*reading.hypotheses, Hypothesis("gravity", (), value)),
            evidence=estimate,
            gravity=gravity,
            log_odds=odds,
        )


def compensated_gravity_readings(case: TorqueCase) -> Iterator[LogReading]:
    """Yield the interpretation that the model file's gravity torques were subtracted.

    The gravity torques are added to the torques of the log; nothing is yielded if they are zero.

    Args:
        case: Joint torques of a log, with robot and prior.
    """
    rest = Motion.at_rest(case.signals.q)
    removed = joint_forces(case.tree, rest, case.gravity).T
    if removed.any():
        yield case.with_torques(
            (Hypothesis("gravity_removed"),),
            COMPENSATION_LOG_ODDS,
            case.signals.torque.T + removed,
            "by file",
        )


def scale_reading(case: TorqueCase) -> LogReading:
    """Interpretation of the log with one scale factor per joint torque, estimated jointly.

    A scale factor multiplies the torque due to the bodies; friction is in the units of the log.
    `sigma` refers to the logarithms of the factors relative to their mean. Joints whose factor is
    not determined get the geometric mean of the determined factors and an infinite `sigma`.

    Args:
        case: Joint torques of a log, with robot and prior.
    """
    n, prior = case.tree.n, np.eye(case.tree.n) / LOG_SCALE_SIGMA**2
    logs, estimate, information = _log_scale_factors(case, prior)
    covariance = np.linalg.inv(information + prior)
    # relative scale factors: a common factor scales all masses
    relative = np.eye(n) - case.usable_channels / case.usable_channels.sum()
    spread = np.sqrt(np.diagonal(relative @ covariance @ relative.T))
    volume = np.linalg.slogdet(np.eye(n) + LOG_SCALE_SIGMA**2 * information)[1]
    odds = float(
        SCALE_LOG_ODDS
        - 0.5
        * (
            logs[case.usable_channels] @ logs[case.usable_channels] / LOG_SCALE_SIGMA**2
            + volume
        )
    )
    known = (
        spread < max(MAX_SIGMA_RATIO * spread[case.usable_channels].min(), KNOWN_SIGMA)
    ) & case.usable_channels
    stated = np.where(known, logs, logs[known].mean())
    sizes = Hypothesis("torque_size", tuple(range(n)), tuple(np.exp(stated).tolist()))
    return replace(
        case.as_given,
        hypotheses=(sizes,),
        kind="torque sizes",
        log_odds=odds,
        evidence=estimate,
        sigma=np.where(known, spread, np.inf),
    )


def _log_scale_factors(case: TorqueCase, prior: Array) -> tuple[Array, Evidence, Array]:
    """Log torque scale factors, (n,), from Gauss-Newton steps; evidence; information, (n, n).

    Args:
        case: Joint torques of a log, with robot and prior.
        prior: Prior information of the log factors, about zero, (n, n).
    """
    products = case.products
    mean = products.mean[: products.shared_count]
    inputs, logs = products.products(case.gravity), np.zeros(case.tree.n)
    variance = None
    for _ in range(MAX_ITERATIONS):
        scaled = inputs.with_scaled_columns(np.exp(logs), mean)
        estimate = case.evidence(scaled, variance, rounds=2)
        variance = estimate.variance
        gradient, information = _scale_step(scaled, estimate, mean)
        change = np.linalg.solve(information + prior, gradient - prior @ logs)
        logs = logs + np.clip(change, -MAX_STEP, MAX_STEP)
    scaled = inputs.with_scaled_columns(np.exp(logs), mean)
    estimate = case.evidence(scaled, variance, rounds=3)
    return logs, estimate, _scale_step(scaled, estimate, mean)[1]


def has_contradictory_scales(reading: LogReading) -> bool:
    """Test whether torque scale factors differ significantly between joints.

    They do if a logarithm deviates by more than 4 standard deviations from the mean, and the range
    of the logarithms exceeds 0.15.

    Args:
        reading: Interpretation with scale factors of the torques.
    """
    known = np.isfinite(reading.sigma)
    logs = np.log(np.array(reading.hypotheses[0].values)[known])
    significant = np.abs(logs - logs.mean()) > Z_THRESHOLD * reading.sigma[known]
    return bool(significant.any() and np.ptp(logs) > MIN_LOG_RANGE)


def _scale_step(
    products: ChannelProducts, estimate: Evidence, mean: Array
) -> tuple[Array, Array]:
    """Gradient, (n,), and information, (n, n), of log torque scale factors.

    Args:
        products: Products of the regressor columns, scaled by the current factors.
        estimate: Evidence with these columns.
        mean: Prior mean of the P coefficients shared by all channels, (P,).
    """
    n, size = len(products.count), len(mean)
    values = np.zeros_like(products.moment)
    values[:, :size] = mean + estimate.shared_mean
    fitted = products.predicted_products(values)
    square = (fitted * values).sum(axis=1)
    residual = products.moment - products.predicted_products(estimate.coefficients)
    moment = (residual * values).sum(axis=1)
    unit = np.eye(n)
    return estimate.additional_gradient(
        fitted[:, :, None] * unit[:, None],
        square[:, None, None] * unit[:, :, None] * unit[:, None],
        moment[:, None] * unit,
    )
