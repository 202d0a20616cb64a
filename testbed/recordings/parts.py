"""Parts of one recording, in the order of time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from testbed.errors import RecordingError
from testbed.recordings.recording import Recording


def alike(parts: Iterable[Recording]) -> Iterator[Recording]:
    """The parts of one recording, as long as they belong together.

    Raises:
        RecordingError: There are none, or their channels differ.
    """
    layout: tuple[object, ...] = ()
    for part in parts:
        here = (part.names, part.signals, part.truth is None)
        if layout and here != layout:
            raise RecordingError("the parts of the recording have different channels")
        layout = here
        yield part
    if not layout:
        raise RecordingError("the recording has no parts")
