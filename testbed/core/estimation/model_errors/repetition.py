"""Lack of fit against pure error: residuals that repeat with a periodic motion are no noise.

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
from testbed.core.base.stages import stage
from testbed.core.estimation.model_errors.error_rows import error_rows
from testbed.core.estimation.model_errors.estimates import RepeatableError
from testbed.core.estimation.model_errors.restricted_likelihood import RegressionRows
from testbed.core.estimation.noise.noise_model import lag_of, period_of
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import TINY, scaled_solve
from testbed.core.recordings.source import Source, by_segments

FEWEST = 12
"""Rows of a period below which nothing is said."""
RECORDINGS = 3
"""Recordings that are compared with the longest."""
SHORT = 0.5
"""Part of the longest recording's samples below which another is too short."""


class MotionRows(NamedTuple):
    """Rows along a motion.

    Attributes:
        positions: (R, n) [rad or m].
        rows: Columns of the unknowns and residuals, (C, R, p + 1).
    """

    positions: Array
    rows: Array

    def between(self, first: float, count: int) -> Array:
        """Rows from a place on, interpolated, (C, count, p + 1).

        Args:
            first: Place among the rows, a fraction, too.
            count: Of rows.
        """
        spline = CubicSpline(np.arange(self.rows.shape[1]), self.rows, axis=1)
        return np.asarray(spline(first + np.arange(count)))


@stage("repetition")
def repeatable_error(problem: Problem, values: Array) -> RepeatableError | None:
    """Repeatable part of an estimate's residuals; None where no motion comes again.

    Args:
        problem: Its terms and filters are chosen; rows are filtered.
        values: Of the unknowns, (p,).
    """
    longest, *others = sorted(
        by_segments(problem.source), key=lambda each: each.samples, reverse=True
    )
    first, rate = _motion_rows(problem, longest, values)
    count = period_of(first.positions)
    if count is not None:
        return _lack_of_fit(_periods(first, count), count / rate, 1)
    found = [
        _motion_rows(problem, other, values)[0]
        for other in others[:RECORDINGS]
        if other.samples > SHORT * longest.samples
    ]
    if not found:  # else a spline of every row is made for nothing
        return None
    rows = _recordings(first, found)
    return _lack_of_fit(rows, rows.shape[2] / rate, rows.shape[1])


def _motion_rows(
    problem: Problem, source: Source, values: Array
) -> tuple[MotionRows, float]:
    """Rows of a recording without gap, and how many a second [Hz]."""
    rows = error_rows(problem, source, values, np.zeros((0, len(values) + 1)), 1)
    every = np.concatenate([rows.columns, rows.measured[..., None]], axis=2)
    white = rows.whitened(every)
    residual = white[..., -1] - white[..., :-1] @ values
    white[..., -1] = residual - residual.mean(axis=1, keepdims=True)
    filtered = rows.linearizer.filter
    rate = rows.linearizer.plan.rate
    first = filtered.reach // filtered.stride
    positions = [
        each.smooth.q[first :: filtered.step][:count]
        for each, (_, count) in zip(rows.states, rows.places, strict=True)
    ]
    return MotionRows(np.concatenate(positions), white), rate


def _periods(motion: MotionRows, count: int) -> Array:
    """Periods of a motion; of less than two the instants that come again, (C, P, n, p + 1).

    Args:
        motion: At least one and a half periods.
        count: Rows of a period.
    """
    length = len(motion.positions)
    number = max(length // count, 2)
    again = min(count, length - count)
    last = length - again
    starts = range(last - (number - 1) * count, last + 1, count)
    each = [motion.rows[:, start : start + again] for start in starts]
    return np.stack(each, axis=1)


def _recordings(first: MotionRows, others: Sequence[MotionRows]) -> Array:
    """Rows that the first recording and those of the same motion share, (C, P, n, p + 1).

    Args:
        first: Of the motion.
        others: Of the same one or another.
    """
    found = [(first, 0.0)]
    for other in others:
        lag = lag_of(first.positions, other.positions)
        if lag is not None:
            found.append((other, lag))
    begin = max(math.ceil(-lag) for _, lag in found)
    end = min(math.ceil(len(motion.positions) - lag) for motion, lag in found)
    each = [motion.between(begin + lag, end - begin) for motion, lag in found]
    return np.stack(each, axis=1)


def _lack_of_fit(
    periods: Array, period: float, recordings: int
) -> RepeatableError | None:
    """Mean period of the residuals against the deviations from it.

    Args:
        periods: Columns of the unknowns and residuals of P periods, (C, P, n, p + 1).
        period: [s].
        recordings: That are compared.

    Returns:
        None for less than two periods or too few rows.
    """
    channels, number, count, width = periods.shape
    if number < 2 or count < FEWEST or count * channels < 2 * (width + channels):
        return None
    residual = periods[..., -1]
    pure = residual - residual.mean(axis=1, keepdims=True)
    pure = (pure * np.sqrt(number / (number - 1))).reshape(channels, -1)
    chance = _chance(_whitened(periods, pure))
    variance = (pure**2).mean(axis=1)
    square = (residual.mean(axis=1) ** 2).mean(axis=1)
    repeats = np.maximum(square - variance / number, 0.0)
    share = repeats / np.maximum(repeats + variance, TINY)
    return RepeatableError(period, recordings, chance, np.sqrt(repeats), share)


def _chance(white: Array) -> float:
    """Probability of such a mean period in white noise, by an F test.

    What the unknowns explain of the mean period does not count: noise of the encoders makes
    parameters too small, and that repeats.

    Args:
        white: Columns of the unknowns and residuals of P periods, (C, P, n, p + 1).
    """
    channels, number, _, width = white.shape
    means = white.mean(axis=1).reshape(-1, width)
    columns = means[:, :-1]
    left = means[:, -1]
    left = left - columns @ scaled_solve(columns.T @ columns, columns.T @ left)
    free = max(len(means) - width + 1 - channels, 1)
    within = len(means) * (number - 1)
    error = white[..., -1].var(axis=1).sum() / within
    ratio = float(left @ left) / free / max(error, TINY)
    return float(special.fdtrc(free, within, ratio))


def _whitened(periods: Array, pure: Array) -> Array:
    """Periods whitened of the noise in the deviations, (C, P, n, k).

    Args:
        periods: (C, P, n, k).
        pure: Deviations of the residuals, (C, P n).
    """
    channels, number, count, width = periods.shape
    flat = periods.reshape(channels, -1, width)
    used = np.ones(pure.shape, np.bool_)
    rows = RegressionRows(flat, pure, used, {}, np.zeros((0, width + 1)))
    noise = rows.noise(pure, 0.0)
    white = rows.whitened(flat, noise).reshape(channels, -1, width)
    if number > 2:  # the first rows have none before them
        return white[:, -(number - 1) * count :].reshape(channels, -1, count, width)
    white = np.pad(white, ((0, 0), (noise.process.order, 0), (0, 0)))
    return white.reshape(channels, number, count, width)
