"""Errors of sampling times detected in positions: lost rows, repeated rows, jitter.

An error of a sampling time shifts the positions of all joints along their velocities, whereas
encoder noise shifts each position independently.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.recordings.source import Source, longest_segment

MAX_SAMPLES = 20_000
"""Largest number of analysed samples."""

INTERPOLATION_WEIGHTS = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6
"""Weights of neighbouring position increments that interpolate an increment to third order."""

VARIANCE_GAIN = float(
    np.sum(np.convolve(np.eye(5)[2] - INTERPOLATION_WEIGHTS, [1.0, -1.0]) ** 2)
)
"""Ratio of the variance of interpolation errors to the variance of white position errors."""

MIN_ROW_ERROR, Z_THRESHOLD = 0.6, 8.0
"""Smallest increment error at a lost or repeated row, in samples and in standard deviations."""

MIN_ROW_DISTANCE = 4
"""Smallest distance between two lost or repeated rows, in moving samples."""

MAX_ROW_SHARE = 0.1
"""Largest share of lost or repeated rows among moving samples; a larger share means jitter."""

MAX_BALANCE = 0.3
"""Largest ratio of the rarer to the more frequent kind of row; a larger ratio means jitter."""

MIN_JITTER, NOISE_FACTOR = 3e-5, 3.0
"""Smallest reported jitter: the sum of a time [s] and a multiple of the encoder noise."""

MIN_RELATIVE_SPEED = 0.5
"""Smallest speed of an analysed sample, as a share of the median speed."""


@dataclass(frozen=True, eq=False)
class SamplingTimeErrors:
    """Errors of a recording's sampling times.

    Attributes:
        lost: Times of the rows after missing rows, (k,) [s].
        repeated: Times of repeated rows, (k,) [s].
        jitter: Standard deviation of the sampling times [s]; zero if noise hides the jitter.
    """

    lost: Array
    repeated: Array
    jitter: float

    @property
    def is_free_of_errors(self) -> bool:
        """True if no error was detected, so that accelerations are reliable."""
        return not (len(self.lost) or len(self.repeated) or self.jitter)

    def diagnostics(self) -> Iterator[Diagnostic]:
        """Yield diagnostics of the detected lost rows, repeated rows and jitter."""
        for kind, times in (("lost", self.lost), ("repeated", self.repeated)):
            if len(times):
                first = ", ".join(f"{time:.4g}" for time in times[:3])
                yield make_diagnostic(
                    f"clock.{kind}-rows", "the recording", len(times), first=first
                )
        if self.jitter:
            yield make_diagnostic("clock.jitter", "the recording", 1e3 * self.jitter)


NO_TIMING_ERRORS = SamplingTimeErrors(np.zeros(0), np.zeros(0), 0.0)
"""Result for sampling times without errors."""


def detect_sampling_time_errors(source: Source) -> SamplingTimeErrors:
    """Detect errors of sampling times in the longest segment of a recording.

    At most `MAX_SAMPLES` samples are analysed. A recording with sensed velocities and accelerations
    is not tested, and no errors are returned.

    Args:
        source: The recording.
    """
    if source.senses_kinematics:
        return NO_TIMING_ERRORS
    first, last = longest_segment(source)
    part = source.part(first, min(last, first + MAX_SAMPLES))
    return sampling_time_errors(part.time, part.position)


class _Increments(NamedTuple):
    """Position increments of moving samples, and their errors of interpolation from neighbours.

    Attributes:
        time: Time after each increment, (m,) [s].
        motion_error: Component of the error along the motion, (m,).
        size: Magnitude of each increment, (m,).
        noise: Standard deviation of the error components normal to the motion.
    """

    time: Array
    motion_error: Array
    size: Array
    noise: float


def sampling_time_errors(time: Array, position: Array) -> SamplingTimeErrors:
    """Errors of sampling times from positions of a smooth motion.

    A lost or repeated row is an increment whose error along the motion exceeds `MIN_ROW_ERROR`
    samples and `Z_THRESHOLD` standard deviations of the errors normal to the motion. Jitter is the
    remaining error along the motion in excess of the error normal to it. If lost and repeated rows
    are about equally frequent, or very frequent, all errors are treated as jitter. If there are too
    few moving samples, no errors are returned.

    Args:
        time: Times of the samples, evenly spaced, (M,) [s].
        position: Positions, (M, n) [rad or m].
    """
    increments = _increments(time, position)
    if increments is None:
        return NO_TIMING_ERRORS
    relative, is_significant = (
        increments.motion_error / increments.size,
        np.abs(increments.motion_error) > Z_THRESHOLD * increments.noise,
    )
    lost, repeated = (
        _row_times(increments.time, sign * relative, is_significant)
        for sign in (1.0, -1.0)
    )
    fewer, more = sorted((len(lost), len(repeated)))
    is_regular = np.abs(relative) < MIN_ROW_ERROR
    # about as many early as late samples: jitter
    if fewer > MAX_BALANCE * more or more > MAX_ROW_SHARE * len(is_regular):
        lost = repeated = np.zeros(0)
        is_regular[:] = True
    spread = _deviation(increments.motion_error[is_regular])
    # time in which the position moves by one unit, per unit of white error
    pace = float(np.median(np.diff(time)) / np.median(increments.size)) / np.sqrt(
        VARIANCE_GAIN
    )
    jitter = pace * np.sqrt(max(spread**2 - increments.noise**2, 0.0))
    is_detectable = jitter > NOISE_FACTOR * pace * increments.noise + MIN_JITTER
    return SamplingTimeErrors(lost, repeated, float(jitter) if is_detectable else 0.0)


def _increments(time: Array, position: Array) -> _Increments | None:
    """Position increments of moving samples; None if there are too few samples.

    A sample is moving if the speed, smoothed over nine increments, exceeds `MIN_RELATIVE_SPEED`
    times its median. At least ten moving samples per element of `INTERPOLATION_WEIGHTS` are needed.

    Args:
        time: Times of the samples, evenly spaced, (M,) [s].
        position: Positions, (M, n) [rad or m].
    """
    steps = np.diff(position, axis=0)
    if len(steps) < 10 * len(INTERPOLATION_WEIGHTS):
        return None
    speed = _moving_sums(steps, np.ones(9) / 9)
    error = (steps[2:-2] - _moving_sums(steps, INTERPOLATION_WEIGHTS))[2:-2]
    size = np.linalg.norm(speed, axis=1)
    is_moving = (size > MIN_RELATIVE_SPEED * np.median(size)) & (size > 0)
    if is_moving.sum() < 10 * len(INTERPOLATION_WEIGHTS):
        return None
    size, error = size[is_moving], error[is_moving]
    direction = speed[is_moving] / size[:, None]
    along = (error * direction).sum(axis=1)
    return _Increments(time[5:-4][is_moving], along, size, _noise(error, direction))


def _moving_sums(steps: Array, weights: Array) -> Array:
    """Weighted sums of neighbouring increments, (m, n)."""
    windows = np.lib.stride_tricks.sliding_window_view(steps, len(weights), axis=0)
    return np.asarray(windows @ weights)


def _noise(error: Array, direction: Array) -> float:
    """Standard deviation of increment errors normal to the motion.

    If a single joint moves, no direction is normal to the motion. All errors of this joint are then
    used, which hides jitter.

    Args:
        error: Errors of increments, (m, n).
        direction: Unit vectors along the motion, (m, n).
    """
    weight = (direction**2).mean(axis=0)
    moving_joints = weight > 0.02 * weight.max()
    if moving_joints.sum() < 2:
        return float(_deviation(error[:, int(weight.argmax())]))
    along = (error * direction).sum(axis=1)[:, None]
    across = (error - along * direction)[:, moving_joints]
    deviations = np.array([_deviation(column) for column in across.T])
    # one of the directions, along the motion, is left out
    correction = moving_joints.sum() / (moving_joints.sum() - 1)
    return float(
        np.sqrt(
            correction
            * (weight[moving_joints] @ deviations**2)
            / weight[moving_joints].sum()
        )
    )


def _deviation(values: Array) -> float:
    """Robust standard deviation, estimated from the median of magnitudes."""
    return float(1.4826 * np.median(np.abs(values))) if len(values) else 0.0


def _row_times(
    time: Array, relative: Array, is_significant: NDArray[np.bool_]
) -> Array:
    """Times of isolated errors of about one sample, largest among neighbouring increments, (k,).

    Args:
        time: Time after each increment, (m,) [s].
        relative: Error of each increment in samples, positive for the wanted kind of row, (m,).
        is_significant: True for errors well above the noise, (m,).
    """
    times: list[float] = []
    last = -MIN_ROW_DISTANCE
    for k in np.flatnonzero(is_significant & (relative > MIN_ROW_ERROR)).tolist():
        neighbours = np.abs(relative[max(k - 2, 0) : k + 3])
        if relative[k] >= neighbours.max() and k - last >= MIN_ROW_DISTANCE:
            times.append(float(time[k]))
            last = k
    return np.array(times)
