"""Several recordings of a robot combined into one source, with gaps between the recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from testbed.core.base.errors import RecordingError
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import (
    DerivedSource,
    Source,
    evaluated_samples,
    segment_sources,
)


class Joined(DerivedSource):
    """Source of several recordings of a robot in sequence, with gaps in between.

    The header is that of the first recording, with the diagnostics of all recordings and their
    common signals. Gaps are included in the sample numbering. All wrenches are shifted to the tare
    of the first recording.
    """

    def __init__(self, parts: Sequence[Source]) -> None:
        """Join recordings of one robot at one rate.

        Args:
            parts: Recordings in any order; nothing is assumed about the motion between them.

        Raises:
            RecordingError: The recordings differ in robot, gravity, rate or presence of a tare.
        """
        self._parts = tuple(
            evaluated_samples(segment)
            for part in parts
            for segment in segment_sources(part)
        )
        first = self._parts[0]
        _check_consistency(self._parts)
        lengths = np.array([part.samples for part in self._parts])
        # samples between two recordings, at least a second: longer than noise is correlated
        ends = np.cumsum(lengths + max(16, round(first.rate)))
        begins = np.append(0, ends[:-1])
        super().__init__(first, int(begins[-1] + lengths[-1]), first.rate)
        self.segments = tuple(
            zip(begins.tolist(), (begins + lengths).tolist(), strict=True)
        )
        self.signals = tuple(
            s for s in first.signals if all(s in p.signals for p in parts)
        )
        self.senses_kinematics = all(part.senses_kinematics for part in parts)
        diagnostics = dict.fromkeys(
            d for part in self._parts for d in part.metadata.diagnostics
        )
        self.metadata = replace(
            first.metadata, counted=None, gaps=(), diagnostics=tuple(diagnostics)
        )

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last - 1` of a single recording, without the true signals.

        Times are measured from the start of the first recording. Signals that some recordings lack
        are removed.

        Raises:
            ValueError: The samples are in a gap or belong to several recordings.
        """
        for part, (begin, end) in zip(self._parts, self.segments, strict=True):
            if begin <= first and last <= end:
                recording = part.part(first - begin, last - begin)
                changes: dict[str, Any] = {"tare": self.tare}
                changes["metadata"] = replace(recording.metadata, gaps=())
                if (
                    recording.wrench is not None
                    and part.tare is not None
                    and self.tare is not None
                ):
                    changes["wrench"] = recording.wrench + (self.tare - part.tare)
                changes |= dict.fromkeys(
                    s for s in recording.signals if s not in self.signals
                )
                changes["time"] = (
                    np.asarray(recording.time) - recording.time[0] + first / self.rate
                )
                return replace(recording, **changes)
        raise ValueError(f"samples {first} to {last} are not of one recording")


def joined(parts: Sequence[Source]) -> Source:
    """Join recordings of a robot into one source; return a single recording unchanged.

    Args:
        parts: One or more recordings.

    Raises:
        RecordingError: The recordings differ in robot, gravity, rate or presence of a tare.
    """
    return parts[0] if len(parts) == 1 else Joined(parts)


def _check_consistency(parts: Sequence[Source]) -> None:
    """Check that recordings agree in joints, rate, gravity, geometry and presence of a tare.

    The joints may be in different orders, and rates may differ by 0.1 %.

    Raises:
        RecordingError: A recording differs from the first one.
    """
    first = parts[0]
    for k, other in enumerate(parts[1:], start=2):
        if sorted(other.names) != sorted(first.names):
            raise RecordingError(
                f"recording {k} is of another robot than the first: it has the joints "
                f"{', '.join(other.names)}, the first has {', '.join(first.names)}"
            )
        # largest relative difference of equal sampling rates
        if abs(other.rate - first.rate) > 1e-3 * first.rate:
            raise RecordingError(
                f"recording {k} has {other.rate:g} samples a second, the first has "
                f"{first.rate:g}: import them at one rate"
            )
        for field in ("gravity", "geometry"):
            if getattr(other.metadata, field) != getattr(first.metadata, field):
                raise RecordingError(
                    f"recording {k} has another {field} than the first"
                )
        if (other.tare is None) != (first.tare is None):
            raise RecordingError(
                f"recording {k} and the first do not both say what of the wrench is the pedestal's"
            )
