"""A model with rough masses fitted to rows: one factor a body, within bounds, and friction.

Every body's inertia is the model file's times a factor between a quarter and four, its centre of
mass may be a few centimetres elsewhere; joints rub,
never push; rotors have inertia; channels have a zero of their own. What is left says how well
a reading of the data can be true at all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.sanity.bounded import bounded
from testbed.sanity.model_rows import ModelRows

LEAST, MOST = 0.25, 4.0
"""Factors of bodies' inertias that rough masses may need."""

MOST_GAIN = 300.0
"""Times that torques are too large or too small at most: gears have no higher ratios."""

ROUNDS = 4
"""Of weighing channels by what is left in them."""

FLOOR = 1e-3
"""Part of a channel's variance below which what is left says nothing more: models are rough."""

INDEPENDENT = 40
"""Rows that count as independent: what models leave unexplained has a long memory."""

OWN = 3
"""Unknowns of a joint's own: dry and viscous friction, rotor."""


Part: TypeAlias = tuple[Array, Array, NDArray[np.intp]]
"""Columns and measurement of a channel, and which unknowns the columns are."""


@dataclass(frozen=True, eq=False)
class ScaledFit:
    """How well a reading of the data can be true.

    Attributes:
        factors: Of the bodies' inertias, (n,).
        shifts: Of their centres of mass along x, y, z, in parts of what may be wrong, (3 n,).
        gains: Of the torques: measured ones are so many times what they should be, (n,).
        left: Part of each channel's variance that is not explained, (C,).
        rigid: Part of it that bodies explain beyond friction, rotor and zero, (C,).
    """

    factors: Array
    shifts: Array
    gains: Array
    left: Array
    rigid: Array

    @property
    def cost(self) -> float:
        """Minus the logarithm of likelihood, for `INDEPENDENT` rows a channel."""
        return float(INDEPENDENT / 2 * np.log(np.maximum(self.left, FLOOR)).sum())


def scaled_fit(rows: ModelRows, *, free_gains: bool = False) -> ScaledFit:
    """The best factors and friction for rows.

    Args:
        rows: Of the model and of the measurement.
        free_gains: Whether each torque may be any positive multiple of what it should be.
    """
    n, channels = rows.bodies.shape[2], rows.bodies.shape[1]
    gains, found = np.ones(channels), _fitted(rows, np.ones(channels))
    for _ in range(ROUNDS if free_gains else 0):
        steps = np.ones(channels)
        for joint in range(rows.joints):
            steps[joint] = _slope(rows, found, joint) / gains[joint]
        wanted = np.where(steps > 0, gains * steps, gains)
        gains = np.clip(wanted, 1 / MOST_GAIN, MOST_GAIN)
        found = _fitted(rows, gains)
    return replace(found, gains=gains[:n])


def _fitted(rows: ModelRows, gains: Array) -> ScaledFit:
    """Factors and friction, channels weighed by what is left in them."""
    n, channels = rows.bodies.shape[2], rows.bodies.shape[1]
    parts = [_channel(rows, channel, gains[channel]) for channel in range(channels)]
    variance = np.array([max(right @ right, 1e-30) for _, right, _ in parts])
    weights = 1 / variance
    low = np.repeat([LEAST, -1.0, 0.0], [n, 3 * n, OWN * n])
    high = np.repeat([MOST, 1.0, np.inf], [n, 3 * n, OWN * n])
    left, values = variance, np.full(len(low), np.nan)  # at no bound
    for _ in range(ROUNDS):
        values = _bounded(parts, weights, low, high, near=values)
        left = np.array([np.sum((right - a @ values[at]) ** 2) for a, right, at in parts])
        weights = 1 / np.maximum(left, FLOOR * variance)
    alone = [_without_bodies(a, right, n) for a, right, _ in parts]
    rigid = np.maximum(0.0, np.array(alone) - left) / variance
    return ScaledFit(values[:n], values[n : 4 * n], gains[:n], left / variance, rigid)


def _channel(rows: ModelRows, channel: int, gain: float) -> Part:
    """Columns, measurement, and which unknowns the columns are, of one channel without its mean."""
    n = rows.bodies.shape[2]
    columns, unknowns = [rows.bodies[:, channel], rows.shifts[:, channel]], [*range(4 * n)]
    if channel < rows.joints:
        own = (rows.sign, rows.speed, rows.acceleration)
        columns += [signal[:, channel, None] for signal in own]
        unknowns += [4 * n + OWN * channel + k for k in range(OWN)]
    matrix, right = np.hstack(columns), rows.measured[:, channel] / gain
    return matrix - matrix.mean(axis=0), right - right.mean(), np.array(unknowns)


def _bounded(parts: list[Part], weights: Array, low: Array, high: Array, near: Array) -> Array:
    """Least squares within bounds, by products, begun at the bounds a near solution reached."""
    normal, vector = np.zeros((len(low), len(low))), np.zeros(len(low))
    for (matrix, right, at), weight in zip(parts, weights, strict=True):
        normal[np.ix_(at, at)] += weight * matrix.T @ matrix
        vector[at] += weight * matrix.T @ right
    size = np.sqrt(np.where(np.diagonal(normal) > 0, np.diagonal(normal), 1.0))
    scaled = normal / np.outer(size, size) + 1e-9 * np.eye(len(low))
    values: Array = bounded(scaled, vector / size, low * size, high * size, near * size) / size
    return values


def _without_bodies(matrix: Array, right: Array, n: int) -> float:
    """What friction, rotor and zero leave of a channel without any bodies."""
    own = matrix[:, 4 * n :]
    values = np.linalg.lstsq(own, right, rcond=1e-9)[0] if own.shape[1] else np.zeros(0)
    return float(np.sum((right - own @ values) ** 2))


def _slope(rows: ModelRows, fit: ScaledFit, joint: int) -> float:
    """How many times the bodies' torque a joint's measured one is, friction and zero aside."""
    matrix, right, _ = _channel(rows, joint, 1.0)
    rigid = np.concatenate([fit.factors, fit.shifts])
    columns = np.column_stack([matrix[:, : len(rigid)] @ rigid, matrix[:, len(rigid) :]])
    return float(np.linalg.lstsq(columns, right, rcond=1e-9)[0][0])
