"""Readings of where gravity points, and of whether it is in the torques at all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.evidence import Evidence, evidence
from testbed.core.robot.gravity import MOUNTINGS, SIZE
from testbed.importing.check.remedies import Hypothesis
from testbed.importing.check.torque_readings import LogReading, TorqueCase

AXES = {
    name: np.array(gravity) / SIZE
    for name, gravity in MOUNTINGS.items()
    if any(gravity)
}
"""Directions of gravity in the base's frame, by how a robot is mounted."""

ODDS = {"tilt": -3.0, "level": -3.0, "ceiling": -3.0, "wall": -3.5, "inclined": -5.0}
"""Logarithms of prior odds of directions [nats]."""

REMOVED, IN_PART = -4.0, -6.0
"""Of gravity that is not in the torques, wholly or in part [nats]."""

SMALL = np.deg2rad(4)
"""Sigma of a mounting about its axis [rad]."""

SAME = np.cos(np.deg2rad(3))
"""Cosine of directions that are one."""

LEVEL, ALIKE = np.deg2rad(0.5), 2.0
"""Angle to an axis of the base, and standard deviations, below which gravity is along it [rad]."""

STEPS, LARGEST = 12, {"direction": 0.6, "size": 3.0}
"""Steps of Gauss and Newton, and the largest of them: of a direction [rad], of a size [m/s^2]."""

WIDE = 1.6
"""Times the variance of a direction, by its coverage over 290 simulated logs of twelve robots: what
models leave lasts longer than residuals show."""


def tangents(direction: Array) -> Array:
    """Orthonormal tangent vectors of the unit sphere at a direction, (3, 2)."""
    return np.asarray(np.linalg.svd(direction[None])[2][1:].T)


def gravity_readings(case: TorqueCase) -> Iterator[LogReading]:
    """Yield readings with another direction or magnitude of gravity.

    Args:
        case: The log.
    """
    if case.large:
        yield from _on_axes(case)
        return
    none = case.fit(case.products, np.zeros(3))
    yield _reading(case, np.zeros(3), none, "no gravity", REMOVED)
    fits = sorted(
        (_search(case, start, "direction") for start in _starts(case, none)),
        key=lambda each: -each[1].log,
    )
    distinct: list[Array] = []
    for gravity, estimate, information in fits:
        direction = gravity / case.standard
        if any(direction @ other > SAME for other in distinct):
            continue
        distinct.append(direction)
        yield _direction(case, gravity, estimate, information)
    if case.gravity.any():
        yield from _partly(case)


def _on_axes(case: TorqueCase) -> Iterator[LogReading]:
    """Yield readings with gravity along each base axis, and without gravity."""
    directions = {"no gravity": np.zeros(3)} | AXES
    for kind, direction in directions.items():
        gravity = direction * case.standard
        if gravity.any() and gravity @ case.gravity > SAME * case.standard**2:
            continue
        products = case.products_under(gravity)
        odds = ODDS.get(kind.split()[0], REMOVED)
        reading = _reading(case, gravity, case.fit(products, gravity), kind, odds)
        yield replace(reading, products=products)


def _starts(case: TorqueCase, none: Evidence) -> Iterator[Array]:
    """Yield starts of the direction search: stated, linear solution, two axes."""
    products = case.products
    yield case.gravity if case.gravity.any() else case.standard * AXES["level"]
    zero = np.zeros(3)
    gradient, information = products.gravity_step(
        zero, none, products.residual(zero, none)
    )
    step = np.linalg.solve(information + _ridge(information), gradient)
    length = float(np.linalg.norm(step))
    if length > 0.5:
        yield np.asarray(step / length * case.standard)
    axes = [axis * case.standard for axis in AXES.values()]
    others = [axis for axis in axes if axis @ case.gravity < SAME * case.standard**2]
    logs = [case.fit(products, axis, rounds=3).log for axis in others]
    yield from (others[k] for k in np.argsort(logs)[::-1][:2])


def _ridge(information: Array) -> Array:
    size = len(information)
    return np.asarray((1e-9 * np.trace(information) + 1e-12) * np.eye(size))


def _search(
    case: TorqueCase, gravity: Array, free: str
) -> tuple[Array, Evidence, Array]:
    """Maximise the evidence over gravity's direction or magnitude.

    Args:
        case: The log.
        gravity: The start, (3,) [m/s^2].
        free: direction or size.

    Returns:
        Gravity, its evidence, and its information (3, 3).
    """
    products, length = case.products, float(np.linalg.norm(gravity))
    estimate = case.fit(products, gravity)
    for _ in range(STEPS):
        residual = products.residual(gravity, estimate)
        gradient, information = products.gravity_step(gravity, estimate, residual)
        along = gravity[:, None] / np.linalg.norm(gravity)
        if free == "direction":
            along = tangents(along[:, 0]) * length
        reduced = along.T @ information @ along
        step = np.linalg.solve(reduced + _ridge(reduced), along.T @ gradient)
        step *= min(1.0, LARGEST[free] / max(float(np.linalg.norm(step)), 1e-12))
        moved, trial = _line_search(case, gravity, estimate, along @ step, free)
        change = float(np.linalg.norm(moved - gravity))
        better = trial.log - estimate.log
        if better < -1e-3:
            break
        gravity, estimate = moved, trial
        if change < 2e-3 and better < 0.05:
            break
    estimate = case.fit(products, gravity, variance=estimate.variance)
    residual = products.residual(gravity, estimate)
    return gravity, estimate, products.gravity_step(gravity, estimate, residual)[1]


def _line_search(
    case: TorqueCase, gravity: Array, estimate: Evidence, step: Array, free: str
) -> tuple[Array, Evidence]:
    """Backtracking line search along a step of gravity."""
    length = np.linalg.norm(gravity)
    for scale in (1.0, 1 / 3, 1 / 9, 1 / 27):
        moved = gravity + scale * step
        if free == "direction":
            moved = moved * length / np.linalg.norm(moved)
        trial = case.fit(case.products, moved, variance=estimate.variance, rounds=2)
        if trial.log > estimate.log - 1e-3:
            break
    return moved, trial


def _reading(
    case: TorqueCase, gravity: Array, estimate: Evidence, kind: str, odds: float
) -> LogReading:
    value = tuple(np.round(gravity, 4).tolist())
    return LogReading(
        (Hypothesis("gravity", (), value),),
        estimate,
        case.products,
        gravity,
        kind=kind,
        odds=odds,
    )


def _direction(
    case: TorqueCase, gravity: Array, estimate: Evidence, information: Array
) -> LogReading:
    """Reading of a direction, classified by its likeliest prior."""
    size = case.standard
    direction = gravity / size
    across = tangents(direction)
    reduced = across.T @ information @ across * size**2
    covariance = np.linalg.inv(reduced + 1e-3 * np.eye(2))
    volume = 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
    odds = {"inclined": ODDS["inclined"] - np.log(4 * np.pi)}
    centres = dict(AXES)
    if case.gravity.any():
        centres["tilt"] = case.gravity / size
    for name, centre in centres.items():
        apart = np.arccos(np.clip(direction @ centre, -1, 1))
        if name == "level" and "tilt" in centres and centres["tilt"] @ centre > SAME:
            continue
        if apart < 3 * SMALL:
            density = np.log(2 * np.pi * SMALL**2) + 0.5 * (apart / SMALL) ** 2
            odds[name] = ODDS[name.split()[0]] - density
    kind = max(odds, key=lambda name: odds[name])
    reading = _reading(case, gravity, estimate, kind, odds[kind] + volume)
    sigma = np.sqrt(np.linalg.eigvalsh(covariance))
    return replace(reading, sigma=sigma)


def _partly(case: TorqueCase) -> Iterator[LogReading]:
    """Yield the reading with gravity partly compensated."""
    gravity, estimate, information = _search(case, 0.5 * case.gravity, "size")
    part = float(gravity @ case.gravity) / case.standard**2
    sigma = 1 / np.sqrt(max(float(case.gravity @ information @ case.gravity), 1e-12))
    if -0.1 < part < 0.9 and sigma < 0.2:
        odds = IN_PART + float(np.log(2.5 * sigma))
        reading = _reading(case, gravity, estimate, "part of gravity", odds)
        yield replace(reading, sigma=np.array([sigma]))


def on_axis(reading: LogReading) -> LogReading:
    """Reading with gravity rounded to a base axis within its uncertainty.

    Args:
        reading: Of gravity's direction, and its sigma.
    """
    size = float(np.linalg.norm(reading.gravity))
    nearest = max(AXES.values(), key=lambda axis: float(axis @ reading.gravity))
    apart = np.arccos(np.clip(nearest @ reading.gravity / size, -1, 1))
    if apart > max(LEVEL, ALIKE * reading.sigma.max(initial=0.0)):
        return reading
    value = tuple((np.round(size * nearest, 4) + 0.0).tolist())
    gravity = Hypothesis("gravity", (), value)
    hypotheses = [
        gravity if each.kind == "gravity" else each for each in reading.hypotheses
    ]
    return replace(reading, hypotheses=tuple(hypotheses), gravity=size * nearest)


def with_dispersion(case: TorqueCase, reading: LogReading) -> LogReading:
    """Reading with sigma widened by the dispersion between joints.

    The direction without each joint is compared with the one by all.

    Args:
        case: The log.
        reading: Of gravity's direction.
    """
    size, products = case.standard, reading.products
    across = tangents(reading.gravity / size) * size
    information = products.gravity_step(
        reading.gravity, reading.evidence, reading.residual
    )[1]
    covariance = np.linalg.inv(across.T @ information @ across)
    square, degrees = 0.0, 0
    for channel in np.flatnonzero(case.live):
        moved, reduced = _without(case, reading, across, int(channel))
        own = np.linalg.inv(reduced) - covariance
        values, axes = np.linalg.eigh(own)
        shows = values > 0.05 * np.trace(covariance) / 2
        square += float((((axes.T @ moved) ** 2)[shows] / values[shows]).sum())
        degrees += int(shows.sum())
    wide = WIDE * max(1.0, square / max(degrees, 1))
    return replace(reading, sigma=reading.sigma * np.sqrt(wide))


def _without(
    case: TorqueCase, reading: LogReading, across: Array, channel: int
) -> tuple[Array, Array]:
    """Jackknife shift of gravity without one channel, (2,), and its information, (2, 2)."""
    products, gravity = reading.products, reading.gravity
    for _ in range(3):
        inputs = products.products(gravity, reading.measured).without(channel)
        variance = reading.evidence.variance
        estimate = evidence(inputs, case.floor, case.inflation, variance, 1)
        residual = products.residual(gravity, estimate, reading.measured)
        gradient, information = products.gravity_step(gravity, estimate, residual)
        reduced = across.T @ information @ across
        step = np.linalg.solve(reduced + _ridge(reduced), across.T @ gradient)
        gravity = gravity + across @ step
        gravity = gravity * case.standard / np.linalg.norm(gravity)
    return across.T @ (gravity - reading.gravity) / case.standard**2, reduced
