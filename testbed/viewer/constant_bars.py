"""Torque constants as points with error bars, a joint beside the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from testbed.identification.drives.torque_constants import DriveEstimate
from testbed.reporting.drives import BAND
from testbed.viewer.colours import COLOURS

CAP = 0.08
"""Half width of a bar's ends, in distances from joint to joint."""

TALL = 2.0
"""Height of the picture for the largest of what constants are off, in such distances."""


BELOW = 0.08
"""Distance of words from their bar."""


def log_constants(stream: rr.RecordingStream, drives: Sequence[DriveEstimate], at: str) -> None:
    """What each constant is off, with bars and the line at which data sheets are right.

    Args:
        stream: Where to.
        drives: One a joint.
        at: The picture's place among the entities.
    """
    scale = TALL / largest(drives)
    line = [[-0.5, 0.0], [len(drives) - 0.5, 0.0]]
    axis = rr.LineStrips2D([line], colors=[COLOURS["axis"]], radii=[0.006])
    stream.log(f"{at}/right", axis, static=True)
    heights = np.array([-scale * (each.constant - 1) for each in drives])  # y points down
    reach = np.array([scale * BAND * each.sigma for each in drives])
    strips = []
    for place, (height, half) in enumerate(zip(heights, reach, strict=True)):
        low, high = height - half, height + half
        strips.append([[place, low], [place, high]])
        strips += [[[place - CAP, end], [place + CAP, end]] for end in (low, high)]
    bars = rr.LineStrips2D(strips, colors=[COLOURS["external"]], radii=[0.008])
    stream.log(f"{at}/bars", bars, static=True)
    places = np.column_stack([np.arange(len(drives)), heights])
    points = rr.Points2D(places, colors=[COLOURS["external"]], radii=[0.03])
    stream.log(f"{at}/points", points, static=True)
    below = places + np.column_stack([np.zeros(len(drives)), reach + BELOW])
    said = [f"{d.joint} {d.constant:.5g} ± {BAND * d.sigma:.2g}" for d in drives]
    words = rr.Points2D(
        [*below, [len(drives) - 0.5, 0.0]],
        colors=[COLOURS["axis"]],
        radii=[0.001],
        labels=[*said, "1"],
        show_labels=True,
    )
    stream.log(f"{at}/words", words, static=True)


def largest(drives: Sequence[DriveEstimate]) -> float:
    """What constants are off at most, bars included.

    Args:
        drives: One a joint.
    """
    return max([1e-12, *(abs(d.constant - 1) + BAND * d.sigma for d in drives)])
