"""Several recordings of one robot as one source, with gaps between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from testbed.core.base.errors import RecordingError
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import DerivedSource, Source, by_segments, counted


class Joined(DerivedSource):
    """Recordings one after the other, none of which knows of the others.

    The header is the first one's, with the diagnostics of all and the signals that all have; gaps
    count as samples, and the others' wrenches are changed as the first one's tare wants it.
    """

    def __init__(self, parts: Sequence[Source]) -> None:
        """Recordings of one robot at one rate.

        Args:
            parts: In any order; nothing is said of what happened between them, or in their gaps.

        Raises:
            RecordingError: They do not belong together.
        """
        self._parts = tuple(
            counted(segment) for part in parts for segment in by_segments(part)
        )
        first = self._parts[0]
        _check_alike(self._parts)
        lengths = np.array([part.samples for part in self._parts])
        # samples between two recordings, and a second at least: more rows than noise remembers
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
        said = dict.fromkeys(
            d for part in self._parts for d in part.metadata.diagnostics
        )
        self.metadata = replace(
            first.metadata, counted=None, gaps=(), diagnostics=tuple(said)
        )

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1, all of one recording, without the truth."""
        for part, (begin, end) in zip(self._parts, self.segments, strict=True):
            if begin <= first and last <= end:
                found = part.part(first - begin, last - begin)
                changed: dict[str, Any] = {"tare": self.tare}
                changed["metadata"] = replace(found.metadata, gaps=())
                if (
                    found.wrench is not None
                    and part.tare is not None
                    and self.tare is not None
                ):
                    changed["wrench"] = found.wrench + (self.tare - part.tare)
                changed |= dict.fromkeys(
                    s for s in found.signals if s not in self.signals
                )
                changed["time"] = (
                    np.asarray(found.time) - found.time[0] + first / self.rate
                )
                return replace(found, **changed)
        raise ValueError(f"samples {first} to {last} are not of one recording")


def joined(parts: Sequence[Source]) -> Source:
    """Recordings of one robot as one source; a single one as it is.

    Args:
        parts: One or more.

    Raises:
        RecordingError: They do not belong together.
    """
    return parts[0] if len(parts) == 1 else Joined(parts)


def _check_alike(parts: Sequence[Source]) -> None:
    """Whether recordings are of one robot under one gravity, at one rate, and state the tare."""
    first = parts[0]
    for k, other in enumerate(parts[1:], start=2):
        if sorted(other.names) != sorted(first.names):
            raise RecordingError(
                f"recording {k} is of another robot than the first: it has the joints "
                f"{', '.join(other.names)}, the first has {', '.join(first.names)}"
            )
        # relative difference of sampling rates that are one
        if abs(other.rate - first.rate) > 1e-3 * first.rate:
            raise RecordingError(
                f"recording {k} has {other.rate:g} samples a second, the first has "
                f"{first.rate:g}: import them at one rate"
            )
        for what in ("gravity", "geometry"):
            if getattr(other.metadata, what) != getattr(first.metadata, what):
                raise RecordingError(f"recording {k} has another {what} than the first")
        if (other.tare is None) != (first.tare is None):
            raise RecordingError(
                f"recording {k} and the first do not both say what of the wrench is the pedestal's"
            )
