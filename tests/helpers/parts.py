"""Recordings written part by part, as by a program that streams them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from testbed.core.base.arrays import Array
from testbed.core.recordings.formats.parquet import write_table
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import check_parts


def write_parts(parts: Iterable[Recording], path: Path) -> None:
    """Write parts of one recording to a Parquet file, in the order of time, one at a time.

    Raises:
        RecordingError: There are none, or their channels differ.
    """
    whole = iter(check_parts(parts))
    first = next(whole)

    def columns() -> Iterator[dict[str, Array]]:
        yield first.columns() | first.true_columns()
        for part in whole:
            yield part.columns() | part.true_columns()

    write_table(path, first.units(), first.header, columns())
