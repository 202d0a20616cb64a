"""Errors of a recording's sampling times, by its positions alone: lost and repeated rows, jitter.

A wrong time moves all joints along their velocities, noise of the encoders moves each by itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.recordings.source import Source, longest_segment

SAMPLES = 20_000
"""Samples that are looked at, at most."""

INTERPOLATION = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6
"""Weights of the increments beside one, that interpolate it to third order."""

GAIN = float(np.sum(np.convolve(np.eye(5)[2] - INTERPOLATION, [1.0, -1.0]) ** 2))
"""Variance of an increment's error by white errors of positions, over theirs."""

STEP, CLEAR = 0.6, 8.0
"""Error of an increment, in samples, and in standard deviations, of a lost or repeated row."""

ISOLATED = 4
"""Samples within which errors of increments are of one row."""

RARE = 0.1
"""Part of the moving samples above which irregular increments are no single rows."""

BALANCED = 0.3
"""Part of lost rows that repeated ones are at least where neither is, but jitter."""

SMALL_JITTER, TIMES = 3e-5, 3.0
"""Jitter that does no harm [s]; times what noise of the encoders passes for."""

MOVING = 0.5
"""Part of the median speed above which samples count."""


@dataclass(frozen=True, eq=False)
class SamplingTimes:
    """Errors of the times of a recording's samples.

    Attributes:
        lost: Times before which rows are missing, (k,) [s].
        repeated: Times of rows that stand twice, (k,) [s].
        jitter: Standard deviation of the times, zero where noise hides it [s].
    """

    lost: Array
    repeated: Array
    jitter: float

    @property
    def sound(self) -> bool:
        """Whether accelerations can be trusted."""
        return not (len(self.lost) or len(self.repeated) or self.jitter)

    def diagnostics(self) -> Iterator[Diagnostic]:
        """What is wrong, and when."""
        for kind, times in (("lost", self.lost), ("repeated", self.repeated)):
            if len(times):
                first = ", ".join(f"{time:.4g}" for time in times[:3])
                yield diagnose(
                    f"clock.{kind}-rows", "the recording", len(times), first=first
                )
        if self.jitter:
            yield diagnose("clock.jitter", "the recording", 1e3 * self.jitter)


SOUND = SamplingTimes(np.zeros(0), np.zeros(0), 0.0)


def sampling_times(source: Source) -> SamplingTimes:
    """Errors of the sampling times of a recording's longest segment.

    Args:
        source: The recording.
    """
    if source.senses_kinematics:
        return SOUND
    first, last = longest_segment(source)
    part = source.part(first, min(last, first + SAMPLES))
    return errors_of_times(part.time, part.position)


class _Increments(NamedTuple):
    """Increments of moving samples beside those that their neighbours suggest.

    Attributes:
        time: After each, (m,) [s].
        along: Error along the motion, (m,).
        size: Of the increment, (m,).
        noise: Standard deviation of the errors across the motion.
    """

    time: Array
    along: Array
    size: Array
    noise: float


def errors_of_times(time: Array, position: Array) -> SamplingTimes:
    """Errors of sampling times, by positions that should move evenly.

    Args:
        time: Of the samples, evenly spaced, (M,) [s].
        position: (M, n) [rad or m].
    """
    seen = _increments(time, position)
    if seen is None:
        return SOUND
    relative, clear = seen.along / seen.size, np.abs(seen.along) > CLEAR * seen.noise
    lost, repeated = (
        _single(seen.time, sign * relative, clear) for sign in (1.0, -1.0)
    )
    few, many = sorted((len(lost), len(repeated)))
    core = np.abs(relative) < STEP
    # as many too early as too late
    if few > BALANCED * many or many > RARE * len(core):
        lost = repeated = np.zeros(0)
        core[:] = True
    spread = _deviation(seen.along[core])
    # time in which a position moves by one
    pace = float(np.median(np.diff(time)) / np.median(seen.size)) / np.sqrt(GAIN)
    jitter = pace * np.sqrt(max(spread**2 - seen.noise**2, 0.0))
    shows = jitter > TIMES * pace * seen.noise + SMALL_JITTER
    return SamplingTimes(lost, repeated, float(jitter) if shows else 0.0)


def _increments(time: Array, position: Array) -> _Increments | None:
    """Increments of moving samples; None where they are too few."""
    steps = np.diff(position, axis=0)
    if len(steps) < 10 * len(INTERPOLATION):
        return None
    speed = _filtered(steps, np.ones(9) / 9)
    error = (steps[2:-2] - _filtered(steps, INTERPOLATION))[2:-2]
    size = np.linalg.norm(speed, axis=1)
    moving = (size > MOVING * np.median(size)) & (size > 0)
    if moving.sum() < 10 * len(INTERPOLATION):
        return None
    size, error = size[moving], error[moving]
    direction = speed[moving] / size[:, None]
    along = (error * direction).sum(axis=1)
    return _Increments(time[5:-4][moving], along, size, _noise(error, direction))


def _filtered(steps: Array, weights: Array) -> Array:
    """Weighted sums of neighbouring increments, (m, n)."""
    windows = np.lib.stride_tricks.sliding_window_view(steps, len(weights), axis=0)
    return np.asarray(windows @ weights)


def _noise(error: Array, direction: Array) -> float:
    """Standard deviation of errors across the motion; of one joint all of them: they hide jitter.

    Args:
        error: Of increments, (m, n).
        direction: Of the motion, (m, n).
    """
    weight = (direction**2).mean(axis=0)
    joints = weight > 0.02 * weight.max()
    if joints.sum() < 2:
        return float(_deviation(error[:, int(weight.argmax())]))
    along = (error * direction).sum(axis=1)[:, None]
    across = (error - along * direction)[:, joints]
    deviations = np.array([_deviation(column) for column in across.T])
    # of n directions the motion's own is missing
    free = joints.sum() / (joints.sum() - 1)
    return float(
        np.sqrt(free * (weight[joints] @ deviations**2) / weight[joints].sum())
    )


def _deviation(values: Array) -> float:
    """Standard deviation by the median of magnitudes."""
    return float(1.4826 * np.median(np.abs(values))) if len(values) else 0.0


def _single(time: Array, relative: Array, clear: NDArray[np.bool_]) -> Array:
    """Times of errors of about a sample, the largest of neighbours, (k,)."""
    found: list[float] = []
    last = -ISOLATED
    for k in np.flatnonzero(clear & (relative > STEP)).tolist():
        near = np.abs(relative[max(k - 2, 0) : k + 3])
        if relative[k] >= near.max() and k - last >= ISOLATED:
            found.append(float(time[k]))
            last = k
    return np.array(found)
