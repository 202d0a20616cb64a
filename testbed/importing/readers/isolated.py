"""Files read in a child process, because a damaged one can crash or flood the library."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import astuple
from importlib import import_module
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from testbed.core.base.child_process import Returned, call_in_child
from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import ForeignTable, StatedPlate, Tables, readable

SENT = 20_000_000
"""Numbers that come with the names of a file's columns; arrays beyond are read when asked for."""

FIRST_SECONDS, BYTES_A_SECOND = 15.0, 500_000
"""Time that a small file takes at most [s], and bytes of a larger one for each further second."""

FIRST_MEMORY, UNPACKED = 1_500_000_000, 50
"""Memory that a small file takes at most [bytes], and bytes for each byte of a larger one."""


def tables_of(module: str, path: Path, topic: str | None) -> Tables:
    """Read the tables of a file by topic; a file of one table has the topic "".

    Args:
        module: Of the reader, in this package.
        path: The file or folder.
        topic: Of the only table that is wanted; None for all.

    Raises:
        RecordingError: It cannot be read.
        UnknownName: There is no such topic.
    """
    reader = import_module(f"{__package__}.{module}")
    if hasattr(reader, "tables"):
        found: Tables = reader.tables(path, topic)
        return found
    return {"": reader.read_file(path)}


def read_isolated(module: str, path: Path, topic: str | None) -> Tables:
    """Read the tables of a file in a child process, as `tables_of`.

    Args:
        module: Of the reader, in this package.
        path: The file or folder.
        topic: Of the only table that is wanted; None for all.

    Raises:
        RecordingError: It cannot be read, or there is no such topic.
    """

    def called(topic: str | None, first: str | None) -> Returned:
        parts = [each for each in (path, *path.rglob("*")) if each.is_file()]
        size = sum(each.stat().st_size for each in parts)
        return call_in_child(
            f"{__name__}:read",
            str(path),
            module,
            topic,
            first,
            file=path,
            error=RecordingError,
            seconds=FIRST_SECONDS + size / BYTES_A_SECOND,
            memory=FIRST_MEMORY + UNPACKED * size,
        )

    def table(topic: str, said: Any) -> ForeignTable:
        def load(name: str) -> NDArray[Any]:
            if (key := topic + name) not in arrays:
                arrays.clear()
                arrays.update(called(topic or None, name)[1])
            return arrays[key]

        shapes = {name: tuple(shape) for name, shape in said["shapes"].items()}
        plates = [
            StatedPlate(own, tuple(columns), *rest)
            for own, columns, *rest in said["plates"]
        ]
        return ForeignTable(path, shapes, load, said["units"], plates=plates)

    found, read = called(topic, None)
    arrays = {**read}
    return {
        name: RecordingError(said) if isinstance(said, str) else table(name, said)
        for name, said in found
    }


def read(file: str, module: str, topic: str | None, first: str | None) -> Returned:
    """Read shapes, units and arrays of a file's tables, as the child process does.

    Args:
        file: The file or folder.
        module: Of the reader.
        topic: Of the only table that is wanted; None for all.
        first: The array from which on arrays are sent; None for all of them.

    Returns:
        Topics, each with a table's shapes and units or why it is refused; and arrays by topic and
        name, as many as `SENT` allows.
    """
    path, room = Path(file), SENT
    said: list[tuple[str, Any]] = []
    arrays: dict[str, NDArray[Any]] = {}
    for name, table in tables_of(module, path, topic).items():
        if not isinstance(table, ForeignTable):
            said.append((name, str(table)))
            continue
        plates = [astuple(plate) for plate in table.plates]
        said.append(
            (name, {"shapes": table.shapes, "units": table.units, "plates": plates})
        )
        wanted = first is None
        for each, shape in table.shapes.items():
            if each == first:
                wanted = True
                with readable(path):
                    arrays[name + each] = table.load(each)
            elif wanted and (room := room - math.prod(shape)) > 0:
                # said when asked for
                with suppress(ValueError, OSError, RuntimeError, KeyError):
                    arrays[name + each] = table.load(each)
    return said, arrays
