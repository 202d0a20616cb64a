"""Formats of recordings: one module a format, named for the ending of its files.

A module of this room holds a function `open_table(path) -> Table`, which yields columns and
metadata; nothing else knows of it.

In: a file.
Out: named columns, read block by block.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from testbed.core.base.errors import RecordingError, no_file
from testbed.core.base.file_kinds import expecting
from testbed.core.recordings.columns import Table


def is_parquet(path: Path) -> bool:
    """Whether the file begins as Parquet files do."""
    with path.open("rb") as stream:
        return stream.read(4) == b"PAR1"


def formats() -> tuple[str, ...]:
    """The endings of files that can be read, as .parquet."""
    return tuple(sorted(f".{module.name}" for module in iter_modules(__path__)))


def open_table(path: Path) -> Table:
    """The columns of a recording's file.

    Args:
        path: The file; one without a known ending may be Parquet.

    Raises:
        RecordingError: The file is missing or damaged, or its ending is that of no known format.
    """
    with expecting(path, "recording"):
        if not path.exists():
            raise RecordingError(no_file(path, "recording"))
        if not path.is_file():
            raise RecordingError(
                f"'{path}' is no file; testbed new --recording makes one of a dataset"
            )
        ending, known = path.suffix.lower(), formats()
        if ending not in known:  # a file's name never names code: only one of ours is imported
            if ending and not is_parquet(path):
                raise RecordingError(
                    f"unknown format of a recording '{ending}' (known: {', '.join(known)}); "
                    f"another program's file becomes one: testbed new --recording {path}"
                )
            ending = ".parquet"
        found: Table = import_module(f"{__name__}{ending}").open_table(path)
        return found
