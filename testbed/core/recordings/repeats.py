"""Samples that a slow device repeats until its next one: found, and poses interpolated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.recordings.source import Source

DEGREE = 5
"""Of the splines."""


def without_repeated_poses(source: Source) -> tuple[Source, float]:
    """A recording with a new pose at every sample, and the part of its poses that were repeated.

    Args:
        source: The recording; one that is long, joined of several, or that senses velocities and
            accelerations stays as it is, and so does one that repeats its poses irregularly.
    """
    # samples of a recording that is read at once
    if source.samples > 200_000 or source.senses_kinematics or len(source.segments) > 1:
        return source, 0.0
    recording = source.part(0, source.samples)
    _, lengths = runs(recording.position)
    whole = lengths[:-1]
    typical = float(np.median(whole)) if len(whole) > DEGREE else 1.0
    # part of the runs of equal poses that are of one length if a device makes them: steps of an
    # encoder make runs of many lengths
    regular = typical > 1 and np.mean(whole == typical) > 0.95
    if not regular or not np.isfinite(recording.position).all():
        return source, 0.0
    from scipy.interpolate import make_interp_spline

    news = np.flatnonzero(slow_device(recording.position))
    kept = recording.part(0, int(news[-1]) + 1)
    curve = make_interp_spline(news, kept.position[news], k=DEGREE)
    found = replace(kept, position=curve(np.arange(kept.samples)))
    return found, 1 - len(lengths) / recording.samples


REST = 4
"""Times the typical run of equal samples from which a run is a rest of the robot."""


def slow_device(values: Array) -> NDArray[np.bool_]:
    """Which samples are news from a device that is read more often than it measures.

    Of a run of equal samples the first is news; of longer runs than most, every so many. Where
    most samples are news, the others were filled in, but for rests of the robot.

    Args:
        values: Of all channels, (M, k).

    Returns:
        (M,) of bool.
    """
    starts, lengths = runs(values)
    typical, since = (
        _typical(lengths),
        np.arange(len(values)) - np.repeat(starts, lengths),
    )
    filled = (typical == 1) & (np.repeat(lengths, lengths) <= REST)
    found: NDArray[np.bool_] = since % np.where(filled, REST, typical) == 0
    return found


def held_share(values: Array) -> float:
    """Part of the samples that are what the ones before were, rests of the robot aside.

    Args:
        values: Of all channels, (M, k).
    """
    _, lengths = runs(values)
    moving = lengths <= REST * _typical(lengths)
    return float((lengths[moving] - 1).sum() / len(values))


def runs(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First samples of runs of equal ones, and their lengths."""
    changes = np.append(True, (np.diff(values, axis=0) != 0).any(axis=1))
    starts = np.flatnonzero(changes)
    return starts, np.diff(np.append(starts, len(values)))


def _typical(lengths: NDArray[np.intp]) -> int:
    """Length of a run that is hardly ever exceeded but at rest."""
    return max(1, int(np.percentile(lengths, 90, method="lower")))
