"""Interpretations of a log with another direction or size of gravity, or without gravity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.evidence import Evidence, linear_evidence
from testbed.core.robot.gravity import DEFAULT_GRAVITY, GRAVITY_BY_MOUNTING
from testbed.importing.check.remedies import Hypothesis
from testbed.importing.check.torque_readings import LogReading, TorqueCase

GRAVITY_DIRECTIONS = {
    name: np.array(gravity) / DEFAULT_GRAVITY
    for name, gravity in GRAVITY_BY_MOUNTING.items()
    if any(gravity)
}
"""Unit vectors of gravity in the base frame, by mounting of the robot."""

DIRECTION_LOG_ODDS = {
    "tilt": -3.0,
    "level": -3.0,
    "ceiling": -3.0,
    "wall": -3.5,
    "inclined": -5.0,
}
"""Log prior odds of directions of gravity [nats]."""

NO_GRAVITY_LOG_ODDS, PARTIAL_GRAVITY_LOG_ODDS = -4.0, -6.0
"""Log prior odds of torques without gravity, and with a part of gravity [nats]."""

MOUNTING_SIGMA = np.deg2rad(4)
"""Standard deviation of a mounting's direction about its nominal axis [rad]."""

SAME_DIRECTION_COSINE = np.cos(np.deg2rad(3))
"""Cosine of the angle below which two directions are taken as equal."""

AXIS_TOLERANCE, AXIS_Z_THRESHOLD = np.deg2rad(0.5), 2.0
"""Angle to an axis of the base [rad], or the same in standard deviations, below which gravity is
rounded to this axis."""

MAX_ITERATIONS, MAX_STEP = 12, {"direction": 0.6, "size": 3.0}
"""Number of Gauss-Newton iterations, and largest step: of a direction [rad], of a magnitude
[m/s^2]."""

VARIANCE_FACTOR = 1.6
"""Factor on the variance of a direction, from its coverage over 290 simulated logs of twelve
robots: model errors are correlated over longer times than residuals show."""


def tangent_basis(direction: Array) -> Array:
    """Orthonormal tangent vectors of the unit sphere at a direction, (3, 2).

    Args:
        direction: Unit vector, (3,).
    """
    return np.asarray(np.linalg.svd(direction[None])[2][1:].T)


def gravity_readings(case: TorqueCase) -> Iterator[LogReading]:
    """Yield interpretations of the log with another direction or magnitude of gravity.

    The order is: no gravity; the directions of locally maximal evidence that are more than 3 deg
    apart, the likeliest first; and only a part of the stated gravity. For robots with many joints,
    only gravity along the base axes is tested (`_axis_readings`).

    Args:
        case: Joint torques of a log, with robot and prior.
    """
    if case.has_many_joints:
        yield from _axis_readings(case)
        return
    no_gravity = case.fit(case.products, np.zeros(3))
    yield _gravity_reading(
        case, np.zeros(3), no_gravity, "no gravity", NO_GRAVITY_LOG_ODDS
    )
    fits = sorted(
        (
            _optimal_gravity(case, start, "direction")
            for start in _start_vectors(case, no_gravity)
        ),
        key=lambda each: -each[1].log_evidence,
    )
    distinct: list[Array] = []
    for gravity, estimate, information in fits:
        direction = gravity / case.gravity_magnitude
        if any(direction @ other > SAME_DIRECTION_COSINE for other in distinct):
            continue
        distinct.append(direction)
        yield _direction_reading(case, gravity, estimate, information)
    if case.gravity.any():
        yield from _partial_gravity_readings(case)


def _axis_readings(case: TorqueCase) -> Iterator[LogReading]:
    """Yield interpretations of the log without gravity, and with gravity along each base axis.

    Axes within 3 deg of the stated gravity are omitted.
    """
    directions = {"no gravity": np.zeros(3)} | GRAVITY_DIRECTIONS
    for kind, direction in directions.items():
        gravity = direction * case.gravity_magnitude
        if (
            gravity.any()
            and gravity @ case.gravity
            > SAME_DIRECTION_COSINE * case.gravity_magnitude**2
        ):
            continue
        products = case.products_under(gravity)
        log_odds = DIRECTION_LOG_ODDS.get(kind.split()[0], NO_GRAVITY_LOG_ODDS)
        reading = _gravity_reading(
            case, gravity, case.fit(products, gravity), kind, log_odds
        )
        yield replace(reading, products=products)


def _start_vectors(case: TorqueCase, none: Evidence) -> Iterator[Array]:
    """Yield start vectors of the direction search: stated gravity, linear solution, two axes.

    They have the magnitude of the stated gravity [m/s^2]. The linear solution is one Gauss-Newton
    step from zero gravity; the two axes are the base axes with the largest evidence. If the stated
    gravity is zero, gravity along -z replaces it.

    Args:
        case: Joint torques of a log, with robot and prior.
        none: Evidence without gravity.
    """
    products = case.products
    yield (
        case.gravity
        if case.gravity.any()
        else case.gravity_magnitude * GRAVITY_DIRECTIONS["level"]
    )
    zero = np.zeros(3)
    gradient, information = products.gravity_step(
        zero, none, products.residual(zero, none)
    )
    step = np.linalg.solve(information + _ridge(information), gradient)
    length = float(np.linalg.norm(step))
    if length > 0.5:
        yield np.asarray(step / length * case.gravity_magnitude)
    axes = [axis * case.gravity_magnitude for axis in GRAVITY_DIRECTIONS.values()]
    others = [
        axis
        for axis in axes
        if axis @ case.gravity < SAME_DIRECTION_COSINE * case.gravity_magnitude**2
    ]
    logs = [case.fit(products, axis, rounds=3).log_evidence for axis in others]
    yield from (others[k] for k in np.argsort(logs)[::-1][:2])


def _ridge(information: Array) -> Array:
    """Small multiple of the identity, relative to a matrix's trace, that ensures invertibility."""
    size = len(information)
    return np.asarray((1e-9 * np.trace(information) + 1e-12) * np.eye(size))


def _optimal_gravity(
    case: TorqueCase, gravity: Array, free: str
) -> tuple[Array, Evidence, Array]:
    """Maximise the evidence over the direction or magnitude of gravity by Gauss-Newton steps.

    Args:
        case: Joint torques of a log, with robot and prior.
        gravity: Start vector, (3,) [m/s^2].
        free: Free quantity: "direction" or "size" (magnitude).

    Returns:
        Gravity, (3,) [m/s^2], its evidence, and its information, (3, 3).
    """
    products, length = case.products, float(np.linalg.norm(gravity))
    estimate = case.fit(products, gravity)
    for _ in range(MAX_ITERATIONS):
        residual = products.residual(gravity, estimate)
        gradient, information = products.gravity_step(gravity, estimate, residual)
        jacobian = gravity[:, None] / np.linalg.norm(gravity)
        if free == "direction":
            jacobian = tangent_basis(jacobian[:, 0]) * length
        reduced = jacobian.T @ information @ jacobian
        step = np.linalg.solve(reduced + _ridge(reduced), jacobian.T @ gradient)
        step *= min(1.0, MAX_STEP[free] / max(float(np.linalg.norm(step)), 1e-12))
        candidate, trial = _line_search(case, gravity, estimate, jacobian @ step, free)
        change = float(np.linalg.norm(candidate - gravity))
        gain = trial.log_evidence - estimate.log_evidence
        if gain < -1e-3:
            break
        gravity, estimate = candidate, trial
        if change < 2e-3 and gain < 0.05:
            break
    estimate = case.fit(products, gravity, variance=estimate.variance)
    residual = products.residual(gravity, estimate)
    return gravity, estimate, products.gravity_step(gravity, estimate, residual)[1]


def _line_search(
    case: TorqueCase, gravity: Array, estimate: Evidence, step: Array, free: str
) -> tuple[Array, Evidence]:
    """Backtracking line search along a step of gravity; returns gravity and its evidence.

    The step is divided by three, up to three times, until the evidence does not decrease.

    Args:
        case: Joint torques of a log, with robot and prior.
        gravity: Current gravity, (3,) [m/s^2].
        estimate: Evidence at the current gravity.
        step: Change of gravity, (3,) [m/s^2].
        free: Free quantity: "direction" or "size" (magnitude).
    """
    length = np.linalg.norm(gravity)
    for scale in (1.0, 1 / 3, 1 / 9, 1 / 27):
        candidate = gravity + scale * step
        if free == "direction":
            candidate = candidate * length / np.linalg.norm(candidate)
        trial = case.fit(case.products, candidate, variance=estimate.variance, rounds=2)
        if trial.log_evidence > estimate.log_evidence - 1e-3:
            break
    return candidate, trial


def _gravity_reading(
    case: TorqueCase, gravity: Array, estimate: Evidence, kind: str, odds: float
) -> LogReading:
    """Interpretation of the log with another gravity, and its log prior odds."""
    value = tuple(np.round(gravity, 4).tolist())
    return LogReading(
        (Hypothesis("gravity", (), value),),
        estimate,
        case.products,
        gravity,
        kind=kind,
        log_odds=odds,
    )


def _direction_reading(
    case: TorqueCase, gravity: Array, estimate: Evidence, information: Array
) -> LogReading:
    """Interpretation of the log with another gravity direction, classified by its likeliest prior.

    The priors are a tilt from the stated gravity or from a mounting, each with a standard deviation
    of 4 deg, and an inclined base, which is uniform over the sphere. In a Laplace approximation,
    the log odds contain the prior density at the direction and the posterior volume.

    Args:
        case: Joint torques of a log, with robot and prior.
        gravity: Gravity of locally maximal evidence, (3,) [m/s^2].
        estimate: Evidence under this gravity.
        information: Information of gravity, (3, 3) [s^4/m^2].
    """
    size = case.gravity_magnitude
    direction = gravity / size
    tangents = tangent_basis(direction)
    reduced = tangents.T @ information @ tangents * size**2
    covariance = np.linalg.inv(reduced + 1e-3 * np.eye(2))
    volume = 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
    odds = {"inclined": DIRECTION_LOG_ODDS["inclined"] - np.log(4 * np.pi)}
    centres = dict(GRAVITY_DIRECTIONS)
    if case.gravity.any():
        centres["tilt"] = case.gravity / size
    for name, centre in centres.items():
        angle = np.arccos(np.clip(direction @ centre, -1, 1))
        if (
            name == "level"
            and "tilt" in centres
            and centres["tilt"] @ centre > SAME_DIRECTION_COSINE
        ):
            continue
        if angle < 3 * MOUNTING_SIGMA:
            density = (
                np.log(2 * np.pi * MOUNTING_SIGMA**2)
                + 0.5 * (angle / MOUNTING_SIGMA) ** 2
            )
            odds[name] = DIRECTION_LOG_ODDS[name.split()[0]] - density
    kind = max(odds, key=lambda name: odds[name])
    reading = _gravity_reading(case, gravity, estimate, kind, odds[kind] + volume)
    sigma = np.sqrt(np.linalg.eigvalsh(covariance))
    return replace(reading, sigma=sigma)


def _partial_gravity_readings(case: TorqueCase) -> Iterator[LogReading]:
    """Yield the interpretation in which the torques contain only a fraction of gravity.

    The fraction is fitted; it must be between -0.1 and 0.9, with a standard deviation below 0.2.
    """
    gravity, estimate, information = _optimal_gravity(case, 0.5 * case.gravity, "size")
    ratio = float(gravity @ case.gravity) / case.gravity_magnitude**2
    sigma = 1 / np.sqrt(max(float(case.gravity @ information @ case.gravity), 1e-12))
    if -0.1 < ratio < 0.9 and sigma < 0.2:
        odds = PARTIAL_GRAVITY_LOG_ODDS + float(np.log(2.5 * sigma))
        reading = _gravity_reading(case, gravity, estimate, "part of gravity", odds)
        yield replace(reading, sigma=np.array([sigma]))


def rounded_to_axis(reading: LogReading) -> LogReading:
    """Interpretation with gravity rounded to the nearest base axis, if within its uncertainty.

    The angle to the axis must be at most 0.5 deg or 2 standard deviations, whichever is larger.

    Args:
        reading: Interpretation with a direction of gravity and its standard deviations.
    """
    size = float(np.linalg.norm(reading.gravity))
    nearest = max(
        GRAVITY_DIRECTIONS.values(), key=lambda axis: float(axis @ reading.gravity)
    )
    angle = np.arccos(np.clip(nearest @ reading.gravity / size, -1, 1))
    if angle > max(AXIS_TOLERANCE, AXIS_Z_THRESHOLD * reading.sigma.max(initial=0.0)):
        return reading
    value = tuple((np.round(size * nearest, 4) + 0.0).tolist())
    gravity = Hypothesis("gravity", (), value)
    hypotheses = [
        gravity if each.kind == "gravity" else each for each in reading.hypotheses
    ]
    return replace(reading, hypotheses=tuple(hypotheses), gravity=size * nearest)


def with_dispersion(case: TorqueCase, reading: LogReading) -> LogReading:
    """Interpretation with standard deviations increased by the dispersion between joints.

    By the jackknife method, the direction estimated without each joint is compared with the
    direction from all joints. The variance is multiplied by 1.6, and by the mean normalised square
    of these shifts if that exceeds one.

    Args:
        case: Joint torques of a log, with robot and prior.
        reading: Interpretation with a direction of gravity.
    """
    size, products = case.gravity_magnitude, reading.products
    tangents = tangent_basis(reading.gravity / size) * size
    information = products.gravity_step(
        reading.gravity, reading.evidence, reading.residual
    )[1]
    covariance = np.linalg.inv(tangents.T @ information @ tangents)
    square, degrees = 0.0, 0
    for channel in np.flatnonzero(case.usable_channels):
        shift, reduced = _jackknife_shift(case, reading, tangents, int(channel))
        shift_covariance = np.linalg.inv(reduced) - covariance
        values, axes = np.linalg.eigh(shift_covariance)
        determined = values > 0.05 * np.trace(covariance) / 2
        square += float(
            (((axes.T @ shift) ** 2)[determined] / values[determined]).sum()
        )
        degrees += int(determined.sum())
    factor = VARIANCE_FACTOR * max(1.0, square / max(degrees, 1))
    return replace(reading, sigma=reading.sigma * np.sqrt(factor))


def _jackknife_shift(
    case: TorqueCase, reading: LogReading, tangents: Array, channel: int
) -> tuple[Array, Array]:
    """Shift of gravity without one channel, (2,) [rad], and remaining information, (2, 2).

    Args:
        case: Joint torques of a log, with robot and prior.
        reading: Interpretation with the direction of gravity from all channels.
        tangents: Derivatives of gravity with respect to two angles, (3, 2) [m/s^2].
        channel: Index of the omitted torque channel.
    """
    products, gravity = reading.products, reading.gravity
    for _ in range(3):
        inputs = products.products(gravity, reading.measured).without_channel(channel)
        variance = reading.evidence.variance
        estimate = linear_evidence(
            inputs, case.noise_floor, case.inflation, variance, 1
        )
        residual = products.residual(gravity, estimate, reading.measured)
        gradient, information = products.gravity_step(gravity, estimate, residual)
        reduced = tangents.T @ information @ tangents
        step = np.linalg.solve(reduced + _ridge(reduced), tangents.T @ gradient)
        gravity = gravity + tangents @ step
        gravity = gravity * case.gravity_magnitude / np.linalg.norm(gravity)
    return tangents.T @ (gravity - reading.gravity) / case.gravity_magnitude**2, reduced
