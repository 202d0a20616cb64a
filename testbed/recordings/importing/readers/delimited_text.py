"""Numbers in lines of text: CSV and its relatives, plain or packed by gzip.

Lines before the first one of numbers are a preamble; the last of them that has as many fields
names the columns, else they are called 0, 1, .... Columns of text are left out, empty fields are
no numbers (nan). A last line that is incomplete is left out.
"""

from __future__ import annotations

import gzip
import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.recordings.importing.foreign_table import ForeignTable, readable

MOST_TEXT = 500_000_000
"""Bytes of text, unpacked."""

LONGEST_PREAMBLE = 1000
"""Lines before the first one of numbers."""

WHOLE = 2.0**53
"""From here on floating-point numbers leave out whole ones."""

SEPARATORS = (";", "\t", ",", None)
"""Between fields, in the order of trying; None is blanks."""


def read_file(path: Path, topic: str | None) -> ForeignTable:
    """Columns of a text file.

    Args:
        path: The file.
        topic: None.

    Raises:
        RecordingError: It holds no table of numbers.
    """
    del topic
    with readable(path):
        lines = _text(path).splitlines()
        first, separator, decimal = _first_numbers(path, lines)
        lines, cut = _without_cut_end(lines, first, separator)
        wanted = [k for k, x in enumerate(_fields(lines[first], separator)) if _number(x, decimal)]
        names = _names(lines[:first], _fields(lines[first], separator), separator)
        body = "\n".join(line for line in lines[first:] if not _comment(line))
        if decimal == ",":
            body = body.replace(",", ".")
        try:
            table = np.loadtxt(
                io.StringIO(body), delimiter=separator, usecols=wanted, comments=None, ndmin=2
            )
        except ValueError:
            table = _with_holes(
                path, lines, first, separator, decimal, {k: names[k] for k in wanted}
            )
        columns: dict[str, NDArray[Any]] = {}
        for place, k in enumerate(wanted):
            columns[names[k]] = table[:, place]
            if np.abs(table[:, place]).max(initial=0) >= WHOLE:
                columns[names[k]] = _counted(body, separator, k, table[:, place])
    shapes = {name: column.shape for name, column in columns.items()}
    return ForeignTable(path, shapes, columns.__getitem__, cut=cut)


def _without_cut_end(lines: list[str], first: int, separator: str | None) -> tuple[list[str], bool]:
    """The lines without a last one that is incomplete, as where a logger was stopped."""
    last = max(k for k, line in enumerate(lines) if not _comment(line))
    fields = [len(lines[k].strip("\r\n").split(separator)) for k in (first, last)]
    return (lines[:last], True) if fields[1] < fields[0] else (lines, False)


def _with_holes(
    path: Path,
    lines: list[str],
    first: int,
    separator: str | None,
    decimal: str,
    names: dict[int, str],
) -> Array:
    """The table, fields that are empty as no numbers (nan).

    Args:
        path: The file.
        lines: All of it.
        first: Number of the first line of numbers.
        separator: Between fields.
        decimal: The decimal point.
        names: Of the wanted columns, by their places.

    Raises:
        RecordingError: A field is another word, or missing: says the line.
    """
    rows = []
    for number, line in enumerate(lines[first:], first + 1):
        if _comment(line):
            continue
        fields = line.strip("\r\n").split(separator)
        if len(fields) <= max(names):
            raise RecordingError(
                f"{path}: line {number} ends after {len(fields)} of {max(names) + 1} fields"
            )
        for k, name in names.items():
            if fields[k].strip() and not _number(fields[k], decimal):
                raise RecordingError(f"{path}: line {number}: '{name}' is '{fields[k].strip()}'")
        rows.append([_value(fields[k], decimal) for k in names])
    return np.array(rows)


def _counted(body: str, separator: str | None, place: int, read: Array) -> NDArray[Any]:
    """A column of numbers so large that floating-point ones have not all their digits."""
    try:
        lines = body.splitlines()
        return np.array([int(_fields(line, separator)[place]) for line in lines], dtype=np.int64)
    except (ValueError, OverflowError):  # no whole numbers, or more than counters hold
        return read


def _text(path: Path) -> str:
    """What stands in a file."""
    opened = gzip.open if path.suffix.lower() == ".gz" else open
    with opened(path, "rb") as stream:
        data = stream.read(MOST_TEXT + 1)
    if len(data) > MOST_TEXT:
        raise ValueError(f"it has more than {MOST_TEXT:.0e} bytes of text")
    if b"\0" in data:
        raise ValueError("it is no text")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _first_numbers(path: Path, lines: list[str]) -> tuple[int, str | None, str]:
    """Number of the first line of numbers, what separates its fields, and the decimal point."""
    for k, line in enumerate(lines[:LONGEST_PREAMBLE]):
        if _comment(line):
            continue
        for separator in SEPARATORS:
            fields = _fields(line, separator)
            if len(fields) < 2 and separator is not None:
                continue
            for decimal in (".", ",") if separator != "," else (".",):
                numbers = [_number(field, decimal) for field in fields]
                if numbers and 2 * sum(numbers) > len(numbers):
                    return k, separator, decimal
    raise RecordingError(f"{path}: there is no line of numbers in it")


def _names(before: list[str], like: list[str], separator: str | None) -> list[str]:
    """Names of the columns, each once."""
    headers = [_fields(line.lstrip("#% "), separator) for line in before]
    fitting = [fields for fields in headers if len(fields) == len(like)]
    given = fitting[-1] if fitting else []
    names: list[str] = []
    for k in range(len(like)):
        name = given[k].strip().strip("\"'").strip() if given else ""
        name = name or str(k)
        names.append(name if name not in names else f"{name} ({k})")
    return names


def _fields(line: str, separator: str | None) -> list[str]:
    return line.strip().split(separator)


def _comment(line: str) -> bool:
    return not line.strip() or line.lstrip()[0] in "#%"


def _number(field: str, decimal: str) -> bool:
    try:
        value = _value(field, decimal)
    except ValueError:
        return False
    return bool(field.strip()) and "_" not in field and not math.isinf(value)


def _value(field: str, decimal: str) -> float:
    return float((field.replace(",", ".") if decimal == "," else field).strip() or "nan")
