"""Files read in a child process, because a damaged one can crash or flood the library."""

from __future__ import annotations

import math
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from testbed.child_process import Returned, call_in_child
from testbed.errors import RecordingError
from testbed.recordings.importing.foreign_table import ForeignTable, Tables, readable

SENT = 20_000_000
"""Numbers that come with the names of a file's columns; arrays beyond are read when asked for."""

FIRST_SECONDS, BYTES_A_SECOND = 15.0, 500_000
"""Time that a small file takes at most [s], and bytes of a larger one for each further second."""

FIRST_MEMORY, UNPACKED = 1_500_000_000, 50
"""Memory that a small file takes at most [bytes], and bytes for each byte of a larger one."""


def read_isolated(module: str, path: Path, topic: str | None, *, every: bool = False) -> Tables:
    """Tables of a file by topic, read in a child process.

    Args:
        module: Of the reader, in this package.
        path: The file or folder.
        topic: Of one table.
        every: Whether all tables are read.

    Raises:
        RecordingError: It cannot be read.
    """

    def called(array: str | None, topic: str | None, *, every: bool) -> Returned:
        parts = [each for each in (path, *path.rglob("*")) if each.is_file()]
        size = sum(each.stat().st_size for each in parts)
        return call_in_child(
            f"{__name__}:read", str(path), module, topic, every, array,
            file=path, error=RecordingError,
            seconds=FIRST_SECONDS + size / BYTES_A_SECOND,
            memory=FIRST_MEMORY + UNPACKED * size,
        )  # fmt: skip

    def table(topic: str | None, said: dict[str, Any], place: int) -> ForeignTable:
        own = {name: arrays[f"{place} {name}"] for name in said["sent"]}

        def load(name: str) -> NDArray[Any]:
            return own[name] if name in own else called(name, topic, every=False)[1][name]

        shapes = {name: tuple(shape) for name, shape in said["shapes"].items()}
        return ForeignTable(path, shapes, load, said["units"])

    found, arrays = called(None, topic, every=every)
    return {
        name: RecordingError(said) if isinstance(said, str) else table(name, said, place)
        for place, (name, said) in enumerate(found)
    }


def read(file: str, module: str, topic: str | None, every: bool, array: str | None) -> Returned:
    """What a file's tables are called and hold, in the child process.

    Args:
        file: The file or folder.
        module: Of the reader.
        topic: Of one table.
        every: Whether all tables are read.
        array: The only one that is wanted, of one table; None for descriptions of all.

    Returns:
        Topics with descriptions or refusals, and arrays by the table's place and their names.
    """
    path, reader = Path(file), import_module(f"{__package__}.{module}")
    tables: Tables = reader.tables(path) if every else {topic or "": reader.read_file(path, topic)}
    said: list[tuple[str, Any]] = []
    arrays: dict[str, NDArray[Any]] = {}
    room = SENT
    for place, (name, table) in enumerate(tables.items()):
        if not isinstance(table, ForeignTable):
            said.append((name, str(table)))
            continue
        if array is not None:
            with readable(path):
                return None, {array: table.load(array)}
        sent = []
        for each, shape in table.shapes.items():
            room -= math.prod(shape)
            with suppress(ValueError, OSError, RuntimeError, KeyError):  # said when it is asked for
                if room > 0:
                    arrays[f"{place} {each}"] = table.load(each)
                    sent.append(each)
        said.append((name, {"shapes": table.shapes, "units": table.units, "sent": sent}))
    return said, arrays
