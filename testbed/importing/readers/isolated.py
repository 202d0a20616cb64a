"""Reading of files in a child process, because damaged files can crash a library."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import astuple
from importlib import import_module
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from testbed.core.base.child_process import ChildResult, call_in_child
from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import (
    DescribedPlate,
    ForeignTable,
    TablesByTopic,
    reading_errors_as_recording_errors,
)

MAX_SENT_NUMBERS = 20_000_000
"""Largest number of values sent with the column names; further arrays are read on demand."""

BASE_SECONDS, BYTES_PER_SECOND = 15.0, 500_000
"""Time limit for a small file [s], and bytes of a larger file for each further second."""

BASE_MEMORY, MEMORY_PER_BYTE = 1_500_000_000, 50
"""Memory limit for a small file [bytes], and further memory for each byte of the file."""


def read_tables_directly(module: str, path: Path, topic: str | None) -> TablesByTopic:
    """Read the tables of a file, keyed by topic; a single table has topic "".

    Args:
        module: Reader in this package.
        path: File or folder.
        topic: Topic of a single table; None for all tables.

    Raises:
        RecordingError: The file cannot be read.
        UnknownName: There is no such topic.
    """
    reader = import_module(f"{__package__}.{module}")
    if hasattr(reader, "tables"):
        contents: TablesByTopic = reader.tables(path, topic)
        return contents
    return {"": reader.read_file(path)}


def read_tables_in_child(module: str, path: Path, topic: str | None) -> TablesByTopic:
    """Read the tables of a file, keyed by topic, in a child process.

    The result is that of `read_tables_directly`. Arrays beyond a total of `MAX_SENT_NUMBERS` values
    are read on demand, in further processes.

    Args:
        module: Reader in this package.
        path: File or folder.
        topic: Topic of a single table; None for all tables.

    Raises:
        RecordingError: The file cannot be read, or there is no such topic.
    """

    def child_result(topic: str | None, first: str | None) -> ChildResult:
        files = [each for each in (path, *path.rglob("*")) if each.is_file()]
        size = sum(each.stat().st_size for each in files)
        return call_in_child(
            f"{__name__}:read",
            str(path),
            module,
            topic,
            first,
            file=path,
            error=RecordingError,
            seconds=BASE_SECONDS + size / BYTES_PER_SECOND,
            memory=BASE_MEMORY + MEMORY_PER_BYTE * size,
        )

    def table(topic: str, content: Any) -> ForeignTable:
        def load(name: str) -> NDArray[Any]:
            if (key := topic + name) not in arrays:
                arrays.clear()
                arrays.update(child_result(topic or None, name)[1])
            return arrays[key]

        shapes = {name: tuple(shape) for name, shape in content["shapes"].items()}
        plates = [
            DescribedPlate(plate, tuple(columns), *rest)
            for plate, columns, *rest in content["plates"]
        ]
        return ForeignTable(path, shapes, load, content["units"], plates=plates)

    contents, sent = child_result(topic, None)
    arrays = {**sent}
    return {
        name: RecordingError(content)
        if isinstance(content, str)
        else table(name, content)
        for name, content in contents
    }


def read(file: str, module: str, topic: str | None, first: str | None) -> ChildResult:
    """Read shapes, units and arrays of a file's tables in the child process.

    Args:
        file: File or folder.
        module: Reader in this package.
        topic: Topic of a single table; None for all tables.
        first: First array that is sent; None for all arrays.

    Returns:
        Topics, each with shapes, units and plates of a table or with an error message; and arrays
        keyed by topic and name, up to `MAX_SENT_NUMBERS` values.
    """
    path, remaining = Path(file), MAX_SENT_NUMBERS
    contents: list[tuple[str, Any]] = []
    arrays: dict[str, NDArray[Any]] = {}
    for name, table in read_tables_directly(module, path, topic).items():
        if not isinstance(table, ForeignTable):
            contents.append((name, str(table)))
            continue
        plates = [astuple(plate) for plate in table.plates]
        contents.append(
            (name, {"shapes": table.shapes, "units": table.units, "plates": plates})
        )
        is_sent = first is None
        for each, shape in table.shapes.items():
            if each == first:
                is_sent = True
                with reading_errors_as_recording_errors(path):
                    arrays[name + each] = table.load_array(each)
            elif is_sent and (remaining := remaining - math.prod(shape)) > 0:
                # raised again when the array is loaded
                with suppress(ValueError, OSError, RuntimeError, KeyError):
                    arrays[name + each] = table.load_array(each)
    return contents, arrays
