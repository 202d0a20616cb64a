"""Where sources were silent for too long to be bridged, and the pieces that are left between."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from testbed.arrays import Array
from testbed.diagnostics.diagnostic import Diagnostic, diagnose
from testbed.errors import plural
from testbed.recordings.importing.mapping import SourceTable
from testbed.recordings.importing.source_clock import longest_bridged

SHORTEST = 1.0
"""What is left between two gaps is a recording from this on [s]."""

Window = tuple[float, float]
"""First and last instant [s]."""


def cut(
    window: Window, sources: Mapping[str, SourceTable], times: Mapping[str, Array]
) -> tuple[list[Window], list[Diagnostic]]:
    """Pieces of a window in which no source is silent for too long, and where it was cut.

    The whole window without a word where there is no gap, or no piece is long enough.

    Args:
        window: What is wanted.
        sources: What the mapping says of each.
        times: Of each one's samples, (M,) [s].
    """
    gaps = [(*gap, name) for name, time in times.items() for gap in _gaps(sources[name], time)]
    windows, said, begin = [], [], window[0]
    for last, first, name in sorted(gaps):
        if first <= window[0] or last >= window[1]:
            continue
        windows.append((begin, last))
        begin = max(begin, first)
        said.append(diagnose("import.cut", name, first - last, begin=last - window[0]))
    windows.append((begin, window[1]))
    long = [each for each in windows if each[1] - each[0] >= SHORTEST]
    if not said or not long:
        return [window], []
    if short := len(windows) - len(long):
        said.append(diagnose("import.short", plural(short, "piece"), SHORTEST))
    return long, said


def without_gaps(source: SourceTable, time: Array, part: slice, window: Window) -> slice:
    """A part without samples outside the window that lie beyond a gap.

    Args:
        source: What the mapping says of it.
        time: Of its samples, (M,) [s].
        part: The samples in the window, and some around.
        window: What is wanted.
    """
    first, stop = part.start, part.stop
    for before, after in _gaps(source, time):
        if after <= window[0]:
            first = max(first, int(np.searchsorted(time, after)))
        if before >= window[1]:
            stop = min(stop, int(np.searchsorted(time, before, side="right")))
            break
    return slice(first, stop)


def _gaps(source: SourceTable, time: Array) -> list[Window]:
    """Times of the samples around each gap that is not bridged; a steady device has none."""
    steps = np.diff(time)
    if source.steady or not len(steps):
        return []
    wide = np.flatnonzero(steps > longest_bridged(source, float(np.median(steps))))
    return [(float(time[k]), float(time[k + 1])) for k in wide]
