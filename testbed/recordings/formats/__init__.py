"""Formats of recordings: one reader a file of this room, which yields columns and metadata.

A reader is a function `open_table(path) -> Table`; it is found by the file's ending.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from testbed.errors import RecordingError, UnknownName
from testbed.recordings.columns import Table
from testbed.recordings.formats.magic import is_parquet

READERS = {".parquet": "testbed.recordings.formats.parquet"}
"""Modules with a reader, by the ending of the files they read."""


def open_table(path: Path) -> Table:
    """The columns of a recording's file.

    Args:
        path: The file; one without a known ending may be Parquet.

    Raises:
        RecordingError: The file is missing or damaged.
        UnknownName: The ending is that of no known format.
    """
    if not path.exists():
        raise RecordingError(f"there is no recording '{path}'")
    if not path.is_file():
        raise RecordingError(f"'{path}' is no file; a recording is one")
    ending = path.suffix.lower()
    if ending not in READERS:
        if ending and not is_parquet(path):
            raise UnknownName("format of a recording", ending, READERS)
        ending = ".parquet"
    found: Table = import_module(READERS[ending]).open_table(path)
    return found
