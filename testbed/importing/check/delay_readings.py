"""Interpretations of a log in which the torques are delayed or low-pass filtered."""

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
"""Candidate delays and time constants of a first-order lag [s]."""

LOG_ODDS = {"delay": -4.0, "lag": -5.0}
"""Log prior odds, including the choice among several values [nats]."""

Z_THRESHOLD, MIN_AGREEING_SHARE = 3.0, 0.7
"""Conditions for a common delay: least normalised delay, and least share of the halves of the
joints' records with its sign."""

MIN_DELAY_DURATION = 20.0
"""Duration of a recording below which model errors look like delays [s]."""


class Delay(NamedTuple):
    """Common delay of all joints [s].

    Attributes:
        value: Delay [s].
        sigma: Standard deviation [s].
        is_significant: True if the delay exceeds 3 standard deviations and has the sign of at least
            3, and 70 %, of the estimates (two per joint).
    """

    value: float
    sigma: float
    is_significant: bool


def delay_readings(case: TorqueCase) -> Iterator[LogReading]:
    """Yield interpretations with the likeliest delay and first-order lag of all torques.

    Each candidate in `DELAYS` or `LAGS` is removed from the torques of all joints; the candidate
    with the largest log evidence is yielded.

    Args:
        case: Joint torques of a log, with robot and prior.
    """
    initial = case.as_given
    for kind, values in (("delay", DELAYS), ("lag", LAGS)):
        best: LogReading | None = None
        for value in values:
            measured = _corrected_torques(case, kind, value)
            estimate = case.fit(
                case.products, case.gravity, measured, initial.evidence.variance
            )
            if best is None or estimate.log_evidence > best.evidence.log_evidence:
                hypothesis = Hypothesis("delay", (), (float(value),))
                best = replace(
                    initial,
                    hypotheses=(hypothesis,),
                    evidence=estimate,
                    measured=measured,
                    kind=kind,
                    log_odds=LOG_ODDS[kind],
                )
        assert best is not None
        yield best


def _corrected_torques(case: TorqueCase, kind: str, value: float) -> Array:
    """Joint torques with a delay or a first-order lag removed, (n, T), at T instants.

    Args:
        case: Joint torques of a log, with robot and prior.
        kind: "delay" or "lag".
        value: Delay or time constant [s].
    """
    lag = kind == "lag"
    return case.signals.delayed(0.0 if lag else value, value if lag else 0.0).T


def common_delay(case: TorqueCase, reading: LogReading) -> Delay:
    """Random-effects mean of the joints' delays, or of the time constants of their lags [s].

    Each joint's delay is estimated in both halves of the log, as the candidate of maximum
    likelihood. Model errors resemble delays, too (1.5 % of a speed of 1 rad/s resembles 15 ms), but
    they do not resemble equal delays at all joints.

    Args:
        case: Joint torques of a log, with robot and prior.
        reading: Interpretation with torques that are delayed (kind "delay") or low-pass filtered
            (kind "lag").
    """
    candidates = np.sort(np.append(LAGS if reading.kind == "lag" else DELAYS, 0.0))
    halves = np.array_split(np.arange(len(case.signals.sample_indices)), 2)
    variance, squares = reading.evidence.variance, []
    for value in candidates:
        measured = _corrected_torques(case, reading.kind, value)
        estimate = case.fit(case.products, case.gravity, measured, variance, rounds=1)
        residual = case.products.residual(case.gravity, estimate, measured) ** 2
        squares.append([residual[:, half].sum(axis=1) for half in halves])
    square_sums = np.maximum(squares, 1e-12)  # (candidates, 2, C)
    count = np.array([case.signals.valid[half].sum(axis=0) for half in halves])
    logs = -0.5 * count / case.inflation * np.log(square_sums)
    peaks = [
        _peak(candidates, logs[:, half, channel])
        for channel in np.flatnonzero(case.usable_channels)
        for half in range(2)
    ]
    value, sigma = np.array(
        [each for each in peaks if np.isfinite(each[1])] or [(0, np.inf)]
    ).T
    return _random_effects(value, sigma, len(peaks))


def _random_effects(value: Array, sigma: Array, attempts: int) -> Delay:
    """Random-effects mean of delays, and the standard deviation of this mean [DL86].

    For fewer than two estimates, the mean is zero and its standard deviation infinite.

    Args:
        value: Estimated delays, (k,) [s].
        sigma: Standard deviations of the estimates, (k,) [s].
        attempts: Number of attempted estimates, at least k; 70 % of it must have the mean's sign.
    """
    if len(value) < 2:
        return Delay(0.0, np.inf, is_significant=False)
    weight = 1 / sigma**2
    mean = weight @ value / weight.sum()
    excess = weight @ (value - mean) ** 2 - len(value) + 1
    between = excess / (weight.sum() - weight @ weight / weight.sum())
    weight = 1 / (sigma**2 + max(0.0, between))
    mean, spread = weight @ value / weight.sum(), 1 / np.sqrt(weight.sum())
    same_sign_count = int((np.sign(value) == np.sign(mean)).sum())
    agree = abs(mean) > Z_THRESHOLD * spread and same_sign_count >= max(
        3, MIN_AGREEING_SHARE * attempts
    )
    return Delay(float(mean), float(spread), bool(agree))


def _peak(grid: Array, log: Array) -> tuple[float, float]:
    """Maximum of a log likelihood from a parabola, and standard deviation from its curvature.

    The parabola passes through the largest value on the grid and its neighbours; the standard
    deviation is infinite if the parabola has no maximum.

    Args:
        grid: Parameter values, (k,).
        log: Log likelihood on the grid, (k,) [nats].
    """
    k = int(np.clip(np.argmax(log), 1, len(grid) - 2))
    neighbours = slice(k - 1, k + 2)
    curvature, slope, _ = np.polyfit(grid[neighbours] - grid[k], log[neighbours], 2)
    if curvature >= 0:
        return float(grid[k]), np.inf
    maximum = np.clip(grid[k] - slope / (2 * curvature), grid[k - 1], grid[k + 1])
    return float(maximum), float(1 / np.sqrt(-2 * curvature))
