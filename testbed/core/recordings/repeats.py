"""Poses that a slow device repeats until its next one: interpolated between the new ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.core.recordings.source import Source, segments_of
from testbed.importing.source_clock import slow_device

MOST = 200_000
"""Samples of a recording that is read at once."""

REGULAR = 0.95
"""Part of the runs of equal poses that are of one length if a device makes them: steps of an
encoder make runs of many lengths."""

DEGREE = 5
"""Of the splines."""


def without_repeated_poses(source: Source) -> tuple[Source, float]:
    """A recording with a new pose at every sample, and the part of its poses that were repeated.

    Args:
        source: The recording; one that is long, joined of several, or that senses velocities and
            accelerations stays as it is, and so does one that repeats its poses irregularly.
    """
    if source.samples > MOST or source.senses_kinematics or len(segments_of(source)) > 1:
        return source, 0.0
    recording = source.part(0, source.samples)
    changed = np.append(True, (np.diff(recording.position, axis=0) != 0).any(axis=1))
    lengths = np.diff(np.flatnonzero(changed))
    typical = float(np.median(lengths)) if len(lengths) > DEGREE else 1.0
    regular = typical > 1 and np.mean(lengths == typical) > REGULAR
    if not regular or not np.isfinite(recording.position).all():
        return source, 0.0
    from scipy.interpolate import make_interp_spline

    news = np.flatnonzero(slow_device(recording.position))
    kept = recording.part(0, int(news[-1]) + 1)
    curve = make_interp_spline(news, kept.position[news], k=DEGREE)
    found = replace(kept, position=curve(np.arange(kept.samples)))
    return found, float(1 - changed.mean())
