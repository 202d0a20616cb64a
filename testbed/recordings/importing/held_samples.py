"""Samples that a slow device left as they were when it was read again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array

REST = 4
"""Times the typical run of equal samples from which a run is a rest of the robot."""


def slow_device(values: Array) -> NDArray[np.bool_]:
    """Which samples are news from a device that is read more often than it measures.

    Of a run of equal samples the first is news; of longer runs than most, every so many.

    Args:
        values: Of all channels, (M, k).

    Returns:
        (M,) of bool.
    """
    starts, lengths = _runs(values)
    since = np.arange(len(values)) - np.repeat(starts, lengths)
    found: NDArray[np.bool_] = since % _typical(lengths) == 0
    return found


def held_share(values: Array) -> float:
    """Part of the samples that are what the ones before were, rests of the robot aside.

    Args:
        values: Of all channels, (M, k).
    """
    _, lengths = _runs(values)
    moving = lengths <= REST * _typical(lengths)
    return float((lengths[moving] - 1).sum() / len(values))


def _runs(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First samples of runs of equal ones, and their lengths."""
    changes = np.append(True, (np.diff(values, axis=0) != 0).any(axis=1))
    starts = np.flatnonzero(changes)
    return starts, np.diff(np.append(starts, len(values)))


def _typical(lengths: NDArray[np.intp]) -> int:
    """Length of a run that is hardly ever exceeded but at rest."""
    return max(1, int(np.percentile(lengths, 90, method="lower")))
