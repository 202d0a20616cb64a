"""Readings with torques that are late, or low-passed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.importing.check.remedies import Hypothesis
from testbed.importing.check.torque_readings import LogReading, TorqueCase

DELAYS = 1e-3 * np.array(
    [-40, -30, -20, -14, -10, -6, -3, 3, 6, 10, 14, 20, 30, 40, 60, 80.0]
)
LAGS = 1e-3 * np.array([4, 8, 15, 25, 40, 60.0])
"""Delays and time constants that are tried [s]."""

ODDS = {"delay": -4.0, "lag": -5.0}
"""Logarithms of prior odds, with what the choice among several costs [nats]."""

CLEAR, AGREE = 3.0, 0.7
"""Sigmas of a common delay, and part of the joints' halves that have its sign, for it to be one."""

SHORTEST = 20.0
"""Recordings below which models' errors look like delays [s]."""


class Delay(NamedTuple):
    """Common delay of all joints and its standard deviation [s]."""

    value: float
    sigma: float
    agree: bool


def delay_readings(case: TorqueCase) -> Iterator[LogReading]:
    """Yield the likeliest delay and the likeliest first-order lag of all torques.

    Args:
        case: The log.
    """
    first = case.as_given
    for kind, values in (("delay", DELAYS), ("lag", LAGS)):
        best: LogReading | None = None
        for value in values:
            measured = _torques(case, kind, value)
            estimate = case.fit(
                case.products, case.gravity, measured, first.evidence.variance
            )
            if best is None or estimate.log > best.evidence.log:
                late = Hypothesis("delay", (), (float(value),))
                best = replace(
                    first,
                    hypotheses=(late,),
                    evidence=estimate,
                    measured=measured,
                    kind=kind,
                    odds=ODDS[kind],
                )
        assert best is not None
        yield best


def _torques(case: TorqueCase, kind: str, value: float) -> Array:
    """Torques without a delay or a lag, (n, T)."""
    lag = kind == "lag"
    return case.signals.delayed(0.0 if lag else value, value if lag else 0.0).T


def common_delay(case: TorqueCase, reading: LogReading) -> Delay:
    """Random-effects mean of the joints' delays [s].

    Each joint is asked in both halves of the log: errors of models look like delays, too (1.5 % of
    a speed of 1 rad/s like 15 ms), but not like the same everywhere.

    Args:
        case: The log.
        reading: Of late, or low-passed, torques.
    """
    tried = np.sort(np.append(LAGS if reading.kind == "lag" else DELAYS, 0.0))
    halves = np.array_split(np.arange(len(case.signals.at)), 2)
    variance, squares = reading.evidence.variance, []
    for value in tried:
        measured = _torques(case, reading.kind, value)
        estimate = case.fit(case.products, case.gravity, measured, variance, rounds=1)
        residual = case.products.residual(case.gravity, estimate, measured) ** 2
        squares.append([residual[:, half].sum(axis=1) for half in halves])
    left = np.maximum(squares, 1e-12)  # (tried, 2, C)
    count = np.array([case.signals.counted[half].sum(axis=0) for half in halves])
    logs = -0.5 * count / case.inflation * np.log(left)
    peaks = [
        _peak(tried, logs[:, half, channel])
        for channel in np.flatnonzero(case.live)
        for half in range(2)
    ]
    value, sigma = np.array(
        [each for each in peaks if np.isfinite(each[1])] or [(0, np.inf)]
    ).T
    return _random_effects(value, sigma, len(peaks))


def _random_effects(value: Array, sigma: Array, asked: int) -> Delay:
    """Random-effects mean and its standard deviation [DL86]."""
    if len(value) < 2:
        return Delay(0.0, np.inf, agree=False)
    weight = 1 / sigma**2
    mean = weight @ value / weight.sum()
    excess = weight @ (value - mean) ** 2 - len(value) + 1
    between = excess / (weight.sum() - weight @ weight / weight.sum())
    weight = 1 / (sigma**2 + max(0.0, between))
    mean, spread = weight @ value / weight.sum(), 1 / np.sqrt(weight.sum())
    same = int((np.sign(value) == np.sign(mean)).sum())
    agree = abs(mean) > CLEAR * spread and same >= max(3, AGREE * asked)
    return Delay(float(mean), float(spread), bool(agree))


def _peak(at: Array, log: Array) -> tuple[float, float]:
    """Parabolic maximum of a log likelihood, and sigma by its curvature."""
    k = int(np.clip(np.argmax(log), 1, len(at) - 2))
    near = slice(k - 1, k + 2)
    curve, slope, _ = np.polyfit(at[near] - at[k], log[near], 2)
    if curve >= 0:
        return float(at[k]), np.inf
    top = np.clip(at[k] - slope / (2 * curve), at[k - 1], at[k + 1])
    return float(top), float(1 / np.sqrt(-2 * curve))
