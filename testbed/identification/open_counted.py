"""The samples that an estimate is made of, wherever they lie."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from testbed.errors import SettingsError
from testbed.identification.settings import Settings
from testbed.recordings.counted import counted
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source, open_source, segments_of


def open_counted(
    what: Recording | Source | str | Path | Iterable[Recording], settings: Settings
) -> Source:
    """The samples of a recording, or of several, that count.

    Args:
        what: As for `open_source`.
        settings: May say from when to when; else the recording may.

    Raises:
        RecordingError: It is no recording, or none of its samples is in that time.
        SettingsError: A time is said of several recordings.
    """
    source = open_source(what)
    if len(segments_of(source)) == 1:
        return counted(source, settings.span)
    if settings.span is not None:
        raise SettingsError(
            "identification.span is about one recording; of several, cut each where it is imported"
        )
    return source
