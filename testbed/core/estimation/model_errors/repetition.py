"""Lack-of-fit test: residuals that repeat with the motion are not noise.

Source    [DS98] for the F test of lack of fit
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import special
from scipy.interpolate import CubicSpline

from testbed.core.base.arrays import Array
from testbed.core.base.stages import timed_stage
from testbed.core.estimation.model_errors.error_rows import error_rows
from testbed.core.estimation.model_errors.estimates import RepeatableError
from testbed.core.estimation.model_errors.restricted_likelihood import RegressionRows
from testbed.core.estimation.noise.noise_model import lag_of, period_of
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    solve_scaled,
)
from testbed.core.recordings.source import Source, segment_sources

MIN_ROWS = 12
"""Smallest number of rows of a period for the test."""
MAX_RECORDINGS = 3
"""Largest number of recordings that are compared with the longest."""
MIN_LENGTH_SHARE = 0.5
"""Part of the longest recording's samples below which another is too short."""


class MotionRows(NamedTuple):
    """Rows along a motion, with the joint positions.

    Attributes:
        positions: Joint positions at the rows, (R, n) [rad or m].
        rows: Whitened columns of the unknowns, and residuals, (C, R, p + 1).
    """

    positions: Array
    rows: Array

    def interpolated_rows(self, first: float, count: int) -> Array:
        """Consecutive rows interpolated by a cubic spline, (C, count, p + 1).

        Args:
            first: Index of the first row, which may be fractional.
            count: Number of rows.
        """
        spline = CubicSpline(np.arange(self.rows.shape[1]), self.rows, axis=1)
        return np.asarray(spline(first + np.arange(count)))


@timed_stage("repetition")
def repeatable_error(problem: Problem, values: Array) -> RepeatableError | None:
    """Repeatable part of an estimate's residuals; None without a repeated motion.

    Periods of the longest recording are compared (`period_of`). If it has no period, it is compared
    with up to MAX_RECORDINGS other recordings of the same motion (`lag_of`) that have more than
    MIN_LENGTH_SHARE of its samples. The result is also None for too few rows (`_lack_of_fit`).

    Args:
        problem: Problem with chosen terms and filters; rows are filtered.
        values: Unknowns, (p,).
    """
    longest, *others = sorted(
        segment_sources(problem.source), key=lambda each: each.samples, reverse=True
    )
    first, rate = _motion_rows(problem, longest, values)
    count = period_of(first.positions)
    if count is not None:
        return _lack_of_fit(_period_rows(first, count), count / rate, 1)
    repeats = [
        _motion_rows(problem, other, values)[0]
        for other in others[:MAX_RECORDINGS]
        if other.samples > MIN_LENGTH_SHARE * longest.samples
    ]
    if not repeats:  # else a spline of every row is made for nothing
        return None
    rows = _common_rows(first, repeats)
    return _lack_of_fit(rows, rows.shape[2] / rate, rows.shape[1])


def _motion_rows(
    problem: Problem, source: Source, values: Array
) -> tuple[MotionRows, float]:
    """Rows of a recording without gaps, and the rate of rows [Hz].

    The rows are at most the first MAX_ROWS rows of `error_rows`, whitened for the uncertain
    dry friction near standstills.
    Residuals have zero mean in each channel.

    Args:
        problem: Problem with chosen terms and filters.
        source: Recording without gaps.
        values: Unknowns, (p,).
    """
    rows = error_rows(problem, source, values, np.zeros((0, len(values) + 1)), 1)
    columns = np.concatenate([rows.columns, rows.measured[..., None]], axis=2)
    white = rows.whitened_rows(columns)
    residual = white[..., -1] - white[..., :-1] @ values
    white[..., -1] = residual - residual.mean(axis=1, keepdims=True)
    filtered = rows.linearizer.filter
    rate = rows.linearizer.plan.rate
    first = filtered.half_width // filtered.stride
    positions = [
        each.smooth.q[first :: filtered.row_step][:count]
        for each, (_, count) in zip(rows.states, rows.window_rows, strict=True)
    ]
    return MotionRows(np.concatenate(positions), white), rate


def _period_rows(motion: MotionRows, count: int) -> Array:
    """Rows of the last P periods, each of n rows, (C, P, n, p + 1).

    For a motion of less than two periods, the result is its first rows and the rows one period
    later.

    Args:
        motion: Rows of at least one and a half periods.
        count: Number of rows of a period.
    """
    total = len(motion.positions)
    number = max(total // count, 2)
    length = min(count, total - count)
    last = total - length
    starts = range(last - (number - 1) * count, last + 1, count)
    parts = [motion.rows[:, start : start + length] for start in starts]
    return np.stack(parts, axis=1)


def _common_rows(first: MotionRows, others: Sequence[MotionRows]) -> Array:
    """Rows of P recordings at the same n instants of a motion, (C, P, n, p + 1).

    Args:
        first: Rows of the reference recording, the first of the P.
        others: Rows of further recordings; recordings of another motion (`lag_of`) are left out.
    """
    matches = [(first, 0.0)]
    for other in others:
        lag = lag_of(first.positions, other.positions)
        if lag is not None:
            matches.append((other, lag))
    begin = max(math.ceil(-lag) for _, lag in matches)
    end = min(math.ceil(len(motion.positions) - lag) for motion, lag in matches)
    parts = [
        motion.interpolated_rows(begin + lag, end - begin) for motion, lag in matches
    ]
    return np.stack(parts, axis=1)


def _lack_of_fit(
    periods: Array, period: float, recordings: int
) -> RepeatableError | None:
    """Repeatable part of the residuals, tested against the deviations between periods.

    Its mean square is that of the mean period minus the part expected from the deviations.

    Args:
        periods: Columns of the unknowns, and residuals, of P periods, (C, P, n, p + 1).
        period: Period [s].
        recordings: Number of recordings compared.

    Returns:
        Repeatable part; None for fewer than two periods, or if a period has fewer than MIN_ROWS
            rows or fewer than two rows (of all channels) per unknown and channel.
    """
    channels, number, count, width = periods.shape
    if number < 2 or count < MIN_ROWS or count * channels < 2 * (width + channels):
        return None
    residual = periods[..., -1]
    deviations = residual - residual.mean(axis=1, keepdims=True)
    deviations = (deviations * np.sqrt(number / (number - 1))).reshape(channels, -1)
    p_value = _repetition_p_value(_whitened_periods(periods, deviations))
    variance = (deviations**2).mean(axis=1)
    square = (residual.mean(axis=1) ** 2).mean(axis=1)
    repeatable = np.maximum(square - variance / number, 0.0)
    share = repeatable / np.maximum(repeatable + variance, SMALLEST_POSITIVE)
    return RepeatableError(period, recordings, p_value, np.sqrt(repeatable), share)


def _repetition_p_value(white: Array) -> float:
    """P-value of the mean period under white noise, from an F test.

    The part of the mean period that the unknowns explain is removed, since encoder noise attenuates
    the parameters, and this error repeats.

    Args:
        white: Columns of the unknowns, and residuals, of P periods, (C, P, n, p + 1).
    """
    channels, number, _, width = white.shape
    means = white.mean(axis=1).reshape(-1, width)
    columns = means[:, :-1]
    residual = means[:, -1]
    residual = residual - columns @ solve_scaled(
        columns.T @ columns, columns.T @ residual
    )
    free = max(len(means) - width + 1 - channels, 1)
    within = len(means) * (number - 1)
    error = white[..., -1].var(axis=1).sum() / within
    ratio = float(residual @ residual) / free / max(error, SMALLEST_POSITIVE)
    return float(special.fdtrc(free, within, ratio))


def _whitened_periods(periods: Array, deviations: Array) -> Array:
    """Periods whitened by the autoregression of the deviations, (C, P, n, k).

    Of more than two periods, the first is left out, since its first rows have no earlier rows; of
    two periods, these rows are set to zero.

    Args:
        periods: Columns and residuals of P periods, (C, P, n, k).
        deviations: Deviations of the residuals from the mean period, (C, P n).
    """
    channels, number, count, width = periods.shape
    flat = periods.reshape(channels, -1, width)
    mask = np.ones(deviations.shape, np.bool_)
    rows = RegressionRows(flat, deviations, mask, {}, np.zeros((0, width + 1)))
    noise = rows.fit_noise(deviations, 0.0)
    white = rows.whitened_rows(flat, noise).reshape(channels, -1, width)
    if number > 2:  # the first rows have no earlier rows
        return white[:, -(number - 1) * count :].reshape(channels, -1, count, width)
    white = np.pad(white, ((0, 0), (noise.process.order, 0), (0, 0)))
    return white.reshape(channels, number, count, width)
