"""Repeated samples of slow devices: detection, and interpolation of poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.recordings.source import Source

SPLINE_DEGREE = 5
"""Degree of the interpolating splines."""


def interpolate_repeated_poses(source: Source) -> tuple[Source, float]:
    """Replace regularly repeated poses of a recording by spline interpolation.

    Poses are regularly repeated if more than 95 % of the runs of equal poses have the median
    length, and this length is above one. A quintic spline through the new poses (`new_sample_mask`)
    replaces the other poses; samples after the last new pose are removed. Recordings with more than
    200,000 samples, with gaps, or with sensed velocities and accelerations are returned unchanged.

    Args:
        source: The recording.

    Returns:
        The recording, and the share of repeated poses that were replaced (0 if unchanged).
    """
    # largest number of samples that are read at once
    if source.samples > 200_000 or source.senses_kinematics or len(source.segments) > 1:
        return source, 0.0
    recording = source.part(0, source.samples)
    _, lengths = runs_of_equal_rows(recording.position)
    whole = lengths[:-1]
    typical = float(np.median(whole)) if len(whole) > SPLINE_DEGREE else 1.0
    # smallest share of runs of equal poses that have the typical length, for a slow device:
    # encoder steps cause runs of many lengths
    is_regular = typical > 1 and np.mean(whole == typical) > 0.95
    if not is_regular or not np.isfinite(recording.position).all():
        return source, 0.0
    from scipy.interpolate import make_interp_spline

    new_samples = np.flatnonzero(new_sample_mask(recording.position))
    trimmed = recording.part(0, int(new_samples[-1]) + 1)
    curve = make_interp_spline(
        new_samples, trimmed.position[new_samples], k=SPLINE_DEGREE
    )
    interpolated = replace(trimmed, position=curve(np.arange(trimmed.samples)))
    return interpolated, 1 - len(lengths) / recording.samples


REST_FACTOR = 4
"""Smallest length of a rest period, as a multiple of the typical run of equal samples."""


def new_sample_mask(values: Array) -> NDArray[np.bool_]:
    """Mask of new measurements of a device that is sampled faster than it measures.

    The usual length of a run of equal samples is the 90th percentile. The first sample of each run
    is new; in longer runs, one sample per usual length is new. If the usual length is one sample,
    only the first sample of runs of up to `REST_FACTOR` samples is new, while all samples of longer
    runs, in which the robot is at rest, are new.

    Args:
        values: Values of all channels, (M, k).

    Returns:
        True for new samples, (M,).
    """
    starts, lengths = runs_of_equal_rows(values)
    typical, age = (
        _typical_length(lengths),
        np.arange(len(values)) - np.repeat(starts, lengths),
    )
    is_filled = (typical == 1) & (np.repeat(lengths, lengths) <= REST_FACTOR)
    is_new: NDArray[np.bool_] = age % np.where(is_filled, REST_FACTOR, typical) == 0
    return is_new


def repeated_sample_share(values: Array) -> float:
    """Share of samples that repeat the previous sample, excluding rest periods of the robot.

    Rest periods are runs of equal samples longer than `REST_FACTOR` times the 90th percentile of
    run lengths.

    Args:
        values: Values of all channels, (M, k).
    """
    _, lengths = runs_of_equal_rows(values)
    is_moving = lengths <= REST_FACTOR * _typical_length(lengths)
    return float((lengths[is_moving] - 1).sum() / len(values))


def runs_of_equal_rows(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the first samples of runs of equal samples, and lengths of the runs.

    Args:
        values: Values of all channels, (M, k).
    """
    changes = np.append(True, (np.diff(values, axis=0) != 0).any(axis=1))
    starts = np.flatnonzero(changes)
    return starts, np.diff(np.append(starts, len(values)))


def _typical_length(lengths: NDArray[np.intp]) -> int:
    """Typical length of a run of equal samples in motion: 90th percentile of all lengths."""
    return max(1, int(np.percentile(lengths, 90, method="lower")))
