"""Readings with torques in another order, of another sense or size, or without gravity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion, joint_forces
from testbed.core.estimation.evidence import Evidence
from testbed.importing.check.gravity_readings import AXES, ODDS
from testbed.importing.check.remedies import MOST_JOINTS, Hypothesis, orders, own_joints
from testbed.importing.check.torque_readings import LogReading, TorqueCase

ALL, ONE, EXCHANGED, SIZES, BY_FILE = -3.0, -4.0, -5.0, -6.0, -4.0
"""Logarithms of prior odds: of the opposite sense of all torques and of one, of two exchanged, of
other sizes, and of the model file's gravity subtracted [nats]."""

FACTOR = 0.4
"""Sigma of the logarithm of a torque's size."""

STEPS, STEP = 6, 0.5
"""Steps of Gauss and Newton to the sizes, and the largest of their logarithms."""

KNOWN, SHARP = 2.0, 0.1
"""Times the least sigma of a size, and sigma in any case, below which a size is known."""


def column_readings(case: TorqueCase, joints: Sequence[int]) -> Iterator[LogReading]:
    """Readings with torques of other columns or senses.

    Args:
        case: The log.
        joints: Indices of those with torques that tell something.
    """
    torque = case.signals.torque.T
    every = tuple(range(case.tree.n))
    opposite = Hypothesis("torque_sign", every)
    reading = case.with_torques((opposite,), ALL, -torque, "sign of all")
    yield reading
    if not case.fixed:
        yield from _opposite_on_axes(case, reading, -torque)
    for joint in joints:
        sign = np.where(np.arange(len(torque)) == joint, -1.0, 1.0)
        one = Hypothesis("torque_sign", (joint,))
        yield case.with_torques((one,), ONE, sign[:, None] * torque, "torque sign")
    if case.tree.n > MOST_JOINTS:
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
    """All torques of the opposite sense on a robot that is mounted otherwise.

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
            log=estimate.log + odds,
            evidence=estimate,
            gravity=gravity,
            odds=odds,
        )


def without_file_gravity(case: TorqueCase) -> Iterator[LogReading]:
    """The reading of torques from which the model file's gravity was subtracted."""
    signals = case.signals
    still = np.zeros_like(signals.q)
    motion = Motion(np.arange(float(len(still))), signals.q, still, still)
    removed = joint_forces(case.tree, motion, case.gravity).T
    if removed.any():
        yield case.with_torques(
            (Hypothesis("gravity_removed"),),
            BY_FILE,
            signals.torque.T + removed,
            "by file",
        )


def size_reading(case: TorqueCase) -> LogReading:
    """The reading of torques that are each of another size, all sizes found together.

    Args:
        case: The log.
    """
    products, torque, n = case.products, case.signals.torque.T, case.tree.n
    logs, variance, precision = np.zeros(n), None, np.eye(n) / FACTOR**2
    for _ in range(STEPS):
        measured = torque * np.exp(-logs)[:, None]
        estimate = case.fit(products, case.gravity, measured, variance, rounds=2)
        variance = estimate.variance
        gradient, information = _sizes_step(case, estimate, measured)
        gradient -= logs / FACTOR**2
        step = np.linalg.solve(information + precision, gradient)
        logs = logs + np.clip(step, -STEP, STEP)
    measured = torque * np.exp(-logs)[:, None]
    estimate = case.fit(products, case.gravity, measured, variance, rounds=3)
    information = _sizes_step(case, estimate, measured)[1]
    covariance = np.linalg.inv(information + precision)
    # of sizes beside each other: a common factor is that of all masses
    relative = np.eye(n) - case.live / case.live.sum()
    spread = np.sqrt(np.diagonal(relative @ covariance @ relative.T))
    # torques of other sizes are of another density
    counted = products.count / case.inflation
    jacobian = -(counted * logs)[case.live].sum()
    volume = np.linalg.slogdet(np.eye(n) + FACTOR**2 * information)[1]
    penalty = ((logs / FACTOR) ** 2)[case.live].sum()
    odds = float(SIZES + jacobian - 0.5 * (penalty + volume))
    known = (spread < max(KNOWN * spread[case.live].min(), SHARP)) & case.live
    told = np.where(known, logs, logs[known].mean())
    joints = tuple(range(n))
    sizes = Hypothesis("torque_size", joints, tuple(np.exp(told).tolist()))
    reading = case.with_torques((sizes,), odds, measured, "torque sizes")
    return replace(
        reading,
        evidence=estimate,
        log=estimate.log + odds,
        sigma=np.where(known, spread, np.inf),
    )


def _sizes_step(
    case: TorqueCase, estimate: Evidence, measured: Array
) -> tuple[Array, Array]:
    """Gradient, (n,), and information, (n, n), of the logarithms of the torques' sizes."""
    products, unit = case.products, np.eye(case.tree.n)
    residual = products.residual(case.gravity, estimate, measured)
    predicted = products.counted * measured - residual
    inputs = products.products(case.gravity, measured)
    values = products.mean + estimate.coefficients
    fitted = (inputs.gram @ values[:, :, None])[:, :, 0]
    square = (fitted * values).sum(axis=1)
    own = unit[:, :, None] * unit[:, None]  # a channel's columns are its own alone
    moment = (predicted * residual).sum(axis=1)
    return estimate.marginal(
        fitted[:, :, None] * unit[:, None],
        square[:, None, None] * own,
        moment[:, None] * unit,
    )
