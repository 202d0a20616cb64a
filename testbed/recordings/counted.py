"""Which samples of a recording are for an estimate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.errors import RecordingError
from testbed.recordings.checks import COUNTED
from testbed.recordings.source import Source, Stretch


def counted(source: Source, span: Sequence[float] | None = None) -> Source:
    """The samples of a recording that count.

    Args:
        source: One recording.
        span: From the first to before the second time [s]; default what the recording says, as one
            from rest to rest does, else all.

    Raises:
        RecordingError: None of its samples is in that time.
    """
    span = span or source.facts.get(COUNTED)
    if span is None or source.samples < 2:
        return source
    begin = float(source.part(0, 1).time[0])
    first, last = (
        int(np.clip(np.ceil((time - begin) * source.rate - 1e-6), 0, source.samples))
        for time in span
    )
    if first == last:
        end = begin + (source.samples - 1) / source.rate
        raise RecordingError(
            f"the recording goes from {begin:g} to {end:g} s: it has nothing from {span[0]:g} to "
            f"{span[1]:g} s, which is to be counted (identification.span)"
        )
    return source if last - first == source.samples else Stretch(source, first, last)
