"""Readings with torques in another order, of another sense or size, or without gravity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion, joint_forces
from testbed.core.estimation.evidence import ChannelProducts, Evidence
from testbed.importing.check.gravity_readings import AXES, ODDS
from testbed.importing.check.remedies import Hypothesis, orders, own_joints
from testbed.importing.check.torque_readings import LogReading, TorqueCase

ALL, ONE, EXCHANGED, SIZES, BY_FILE = -3.0, -4.0, -5.0, -6.0, -4.0
"""Logarithms of prior odds: of the opposite sense of all torques and of one, of two exchanged, of
other sizes, and of the model file's gravity subtracted [nats]."""

FACTOR = 0.4
"""Sigma of the logarithm of a torque's size."""

STEPS, STEP = 6, 0.5
"""Steps of Gauss and Newton to the sizes, and the largest of their logarithms."""

CLEAR, LEAST = 4.0, 0.15
"""Standard deviations, and range of logarithms, from which torques' sizes contradict each other:
right logs show up to 2.7 standard deviations and .08."""

KNOWN, SHARP = 2.0, 0.1
"""Times the least sigma of a size, and sigma in any case, below which a size is known."""


def column_readings(case: TorqueCase, joints: Sequence[int]) -> Iterator[LogReading]:
    """Yield readings with torques of other columns or opposite signs.

    Args:
        case: The log.
        joints: Indices of those with torques that count.
    """
    torque = case.signals.torque.T
    every = tuple(range(case.tree.n))
    opposite = Hypothesis("torque_sign", every)
    reading = case.with_torques((opposite,), ALL, -torque, "sign of all")
    yield reading
    if not (case.fixed or case.large):
        yield from _opposite_on_axes(case, reading, -torque)
    for joint in joints:
        sign = np.where(np.arange(len(torque)) == joint, -1.0, 1.0)
        one = Hypothesis("torque_sign", (joint,))
        yield case.with_torques((one,), ONE, sign[:, None] * torque, "torque sign")
    if case.large:
        return
    for order in orders(own_joints(case.tree)):
        moved = tuple(k for k, other in enumerate(order) if k != other)
        if set(moved) & set(joints):
            exchange = Hypothesis("torque_order", moved, order)
            measured = torque[list(order)]
            yield case.with_torques((exchange,), EXCHANGED, measured, "torque order")


def _opposite_on_axes(
    case: TorqueCase, reading: LogReading, measured: Array
) -> Iterator[LogReading]:
    """Yield readings with opposite torque signs and gravity along another axis.

    Together they look like a robot as given whose friction and inertial torques are reversed.
    """
    for name, axis in AXES.items():
        gravity = axis * case.standard
        if gravity @ case.gravity > 0.99 * case.standard**2:
            continue
        odds = ALL + ODDS[name.split()[0]]
        estimate = case.fit(reading.products, gravity, measured)
        value = tuple(gravity.tolist())
        yield replace(
            reading,
            hypotheses=(*reading.hypotheses, Hypothesis("gravity", (), value)),
            evidence=estimate,
            gravity=gravity,
            odds=odds,
        )


def without_file_gravity(case: TorqueCase) -> Iterator[LogReading]:
    """Yield the reading with gravity torques of the model file subtracted."""
    rest = Motion.at_rest(case.signals.q)
    removed = joint_forces(case.tree, rest, case.gravity).T
    if removed.any():
        yield case.with_torques(
            (Hypothesis("gravity_removed"),),
            BY_FILE,
            case.signals.torque.T + removed,
            "by file",
        )


def size_reading(case: TorqueCase) -> LogReading:
    """Reading with one scale factor per joint torque, estimated jointly.

    A size multiplies what the bodies make of a torque; friction is in the log's own units.

    Args:
        case: The log.
    """
    n, prior = case.tree.n, np.eye(case.tree.n) / FACTOR**2
    logs, estimate, information = _sizes(case, prior)
    covariance = np.linalg.inv(information + prior)
    # of sizes beside each other: a common factor is that of all masses
    relative = np.eye(n) - case.live / case.live.sum()
    spread = np.sqrt(np.diagonal(relative @ covariance @ relative.T))
    volume = np.linalg.slogdet(np.eye(n) + FACTOR**2 * information)[1]
    odds = float(SIZES - 0.5 * (logs[case.live] @ logs[case.live] / FACTOR**2 + volume))
    known = (spread < max(KNOWN * spread[case.live].min(), SHARP)) & case.live
    stated = np.where(known, logs, logs[known].mean())
    sizes = Hypothesis("torque_size", tuple(range(n)), tuple(np.exp(stated).tolist()))
    return replace(
        case.as_given,
        hypotheses=(sizes,),
        kind="torque sizes",
        odds=odds,
        evidence=estimate,
        sigma=np.where(known, spread, np.inf),
    )


def _sizes(case: TorqueCase, prior: Array) -> tuple[Array, Evidence, Array]:
    """Log torque scale factors by Gauss-Newton steps, with evidence and information."""
    products = case.products
    mean = products.mean[: products.shared]
    inputs, logs = products.products(case.gravity), np.zeros(case.tree.n)
    variance = None
    for _ in range(STEPS):
        scaled = inputs.scaled(np.exp(logs), mean)
        estimate = case.evidence(scaled, variance, rounds=2)
        variance = estimate.variance
        gradient, information = _sizes_step(scaled, estimate, mean)
        change = np.linalg.solve(information + prior, gradient - prior @ logs)
        logs = logs + np.clip(change, -STEP, STEP)
    scaled = inputs.scaled(np.exp(logs), mean)
    estimate = case.evidence(scaled, variance, rounds=3)
    return logs, estimate, _sizes_step(scaled, estimate, mean)[1]


def contradictory(reading: LogReading) -> bool:
    """Whether torque scale factors differ significantly between joints.

    Args:
        reading: Of torques of other sizes.
    """
    known = np.isfinite(reading.sigma)
    logs = np.log(np.array(reading.hypotheses[0].values)[known])
    clear = np.abs(logs - logs.mean()) > CLEAR * reading.sigma[known]
    return bool(clear.any() and np.ptp(logs) > LEAST)


def _sizes_step(
    products: ChannelProducts, estimate: Evidence, mean: Array
) -> tuple[Array, Array]:
    """Gradient, (n,), and information, (n, n), of log torque scale factors."""
    n, size = len(products.count), len(mean)
    values = np.zeros_like(products.moment)
    values[:, :size] = mean + estimate.shared
    fitted = products.times(values)
    square = (fitted * values).sum(axis=1)
    residual = products.moment - products.times(estimate.coefficients)
    moment = (residual * values).sum(axis=1)
    unit = np.eye(n)
    return estimate.marginal(
        fitted[:, :, None] * unit[:, None],
        square[:, None, None] * unit[:, :, None] * unit[:, None],
        moment[:, None] * unit,
    )
