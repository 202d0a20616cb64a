"""Numbers in lines of text: CSV and its relatives, plain or packed by gzip.

The separator and the decimal point are those by which most fields of the table are numbers.
Lines before the first one of numbers are a preamble; the last of them that has as many fields
names the columns, else they are called 0, 1, .... A line of units beside it is that of the
columns' units. Columns of text are left out, instants are microseconds (`written_times`), empty
fields are no numbers (nan). A last line that is incomplete is left out.
"""

from __future__ import annotations

import csv
import gzip
import math
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import (
    KNOWN,
    MOST_COLUMNS,
    ForeignTable,
    check_count,
    each_once,
    plain,
    readable,
)
from testbed.importing.written_times import DAY, INSTANT, microseconds

MOST_TEXT, MOST_LINES, LONGEST_LINE = 500_000_000, 5_000_000, 1_000_000
"""Characters of text, unpacked; its lines, and the characters of one."""

MOST_FIELDS, LOOKED_AT = 200_000, 60
"""Fields and lines by which a table's style is known."""

LONGEST_PREAMBLE = 1000
"""Lines before the first one of numbers."""

WHOLE = 2.0**53
"""From here on floating-point numbers leave out whole ones."""

STYLES = (
    (";", "."),
    (";", ","),
    ("\t", "."),
    ("\t", ","),
    (",", "."),
    (None, "."),
    (None, ","),
)
"""Separators and decimal points in the order of trying; no separator is blanks."""

MISSING = {"", "-", "--", "nan", "na", "n/a", "#n/a", "null", "none"}
"""Fields without a number, in small letters."""


def read_file(path: Path) -> ForeignTable:
    """Columns of a text file.

    Args:
        path: The file.

    Raises:
        RecordingError: It holds no table of numbers.
    """
    with readable(path):
        lines, ended = _lines(path)
        numbered = [k for k, line in enumerate(lines) if not _comment(line)]
        probes = numbered[len(numbered) // 2 :]
        probes = probes[:: len(probes) // LOOKED_AT + 1]
        fields = 1 + max(
            (lines[k].count(mark) for k in probes for mark in ";\t,"), default=0
        )
        # 1,5;2,5 has more commas
        check_count(path, "fields in a line", fields, 2 * MOST_COLUMNS)
        probes = probes[: max(1, MOST_FIELDS // fields)]
        separator, decimal = max(
            STYLES, key=lambda style: _numeric([lines[k] for k in probes], *style)
        )
        given = lines
        if decimal == ",":
            lines = [line.replace(",", ".") for line in lines]
        rows = [_fields(lines[k], separator) for k in probes]
        width = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
        held = [*zip(*(row for row in rows if len(row) == width), strict=True)]
        wanted = [
            k for k, (values, words) in enumerate(map(_held, held)) if values >= words
        ]
        filled = [k for k in wanted if any(map(str.strip, held[k]))]
        first, above = _first_numbers(path, lines, separator, filled, width)
        names, units = _head(
            [_fields(_bare(given[k]), separator) for k in above], width
        )
        read = [k for k in wanted if names[k] != str(k) or k in filled]
        instants = {
            names[k]: "us"
            for k in read
            if any(map(INSTANT.fullmatch, map(str.strip, held[k])))
        }
        tail = _fields(lines[numbered[-1]], separator)
        cut = len(tail) < len(_fields(lines[first], separator))
        # of numbers with so many digits each, zeros too, the last may lack some
        if not ended:
            others = [
                row for k, row in zip(probes, rows, strict=True) if k != numbered[-1]
            ]
            ends = ["".join(row[-1:]) for row in (*others, tail)]
            *digits, last = [len(end.partition(".")[2]) for end in ends]
            padded = any(end.endswith("0") for end in ends[:-1])
            cut |= padded and len({*digits}) == 1 and last < digits[0]
        body = [k for k in numbered[: -1 if cut else None] if k >= first]
        columns = _columns(path, lines, body, separator, {k: names[k] for k in read})

    def load(name: str) -> NDArray[Any]:
        found = columns[name]
        if isinstance(found, RecordingError):
            raise found
        if name in instants:  # from midnight on they begin again
            return found + DAY * np.append(0, np.cumsum(np.diff(found) < -DAY / 2))
        return found

    shapes = dict.fromkeys(columns, (len(body),))
    return ForeignTable(path, shapes, load, units | instants, cut=cut)


def _columns(
    path: Path,
    lines: list[str],
    body: list[int],
    separator: str | None,
    names: dict[int, str],
) -> dict[str, NDArray[Any] | RecordingError]:
    """Columns by name, or which line is no number in them.

    Args:
        path: The file.
        lines: All of it.
        body: Those of numbers.
        separator: Between fields.
        names: Of columns, by their places.
    """
    odd: dict[str, RecordingError] = {}

    def reader(name: str) -> Callable[[str], float]:
        """Numbers of a column's fields, of which it is asked once and in their order."""
        places = iter(body)

        def value(text: str) -> float:
            place = next(places)
            try:
                return _value(text)
            except ValueError:
                said = f"{path}: line {place + 1}: '{name}' is '{text.strip()}'"
                odd.setdefault(name, RecordingError(said))
                return math.nan

        return value

    table = partial(
        np.loadtxt,
        delimiter=separator,
        comments=None,
        ndmin=2,
        quotechar='"',
        encoding="utf-8",
    )
    try:
        read = table(map(lines.__getitem__, body), usecols=[*names])
    except ValueError:
        last = max(names)
        for k in body:
            if (count := len(_fields(lines[k], separator))) <= last:
                said = f"line {k + 1} ends after {count} of {last + 1} fields"
                raise RecordingError(f"{path}: {said}") from None
        readers = {k: reader(name) for k, name in names.items()}
        read = table(map(lines.__getitem__, body), usecols=[*names], converters=readers)
    found: dict[str, NDArray[Any] | RecordingError] = dict(
        zip(names.values(), read.T, strict=True)
    )
    large = np.nanmax(np.abs(read), axis=0, initial=0) >= WHOLE
    for k in np.array([*names])[large].tolist():
        # no whole numbers, or more than counters hold
        with suppress(ValueError, OverflowError):
            counted = table(
                map(lines.__getitem__, body), usecols=k, converters=int, dtype=np.int64
            )
            found[names[k]] = counted[:, 0]
    return found | odd


def _lines(path: Path, encoding: str = "utf-8-sig") -> tuple[list[str], bool]:
    """Lines of a file, and whether the last one is ended.

    They are read one by one: few packed bytes can be a line that fills the memory.
    """
    opened: Callable[..., TextIO] = gzip.open if path.suffix.lower() == ".gz" else open
    lines: list[str] = []
    total, ended = 0, True
    try:
        with opened(path, "rt", encoding=encoding) as stream:
            while line := stream.readline(LONGEST_LINE + 1):
                lines.append(line.rstrip("\n"))
                total, ended = total + len(line), line.endswith("\n")
                check_count(
                    path, f"characters in line {len(lines)}", len(line), LONGEST_LINE
                )
                if "\0" in line:
                    raise ValueError("it is no text")
                check_count(path, "characters", total, MOST_TEXT)
                check_count(path, "lines", len(lines), MOST_LINES)
    except UnicodeDecodeError as error:  # byte 255 begins no text of UTF-8, but UTF-16
        follows = {
            "utf-8-sig": "utf-16" if error.object[:1] in b"\xff\xfe" else "latin-1"
        }
        return _lines(path, follows.get(encoding, "latin-1"))
    return lines, ended


def _numeric(lines: list[str], separator: str | None, decimal: str) -> float:
    """Part of the fields that are numbers, if lines are written so."""
    texts = [line.replace(",", ".") if decimal == "," else line for line in lines]
    fields = [field for line in texts for field in _fields(line, separator)]
    if separator is not None and 2 * len(fields) < 3 * len(lines):
        return 0.0
    values, words = _held(fields)
    return values / max(1, values + words)


def _first_numbers(
    path: Path, lines: list[str], separator: str | None, wanted: list[int], width: int
) -> tuple[int, list[int]]:
    """Indices of the first line of numbers, and of those before it with as many fields.

    Above a line of numbers alone may be some with a word among them.

    Raises:
        RecordingError: There is none.
    """
    above: list[int] = []
    mixed: list[int] = []
    for k, line in enumerate(lines[:LONGEST_PREAMBLE]):
        fields = _fields(_bare(line), separator)
        if not wanted or not max(wanted) < len(fields) <= width + 1 or not any(fields):
            continue
        values, words = (0, 1) if _comment(line) else _held([fields[j] for j in wanted])
        if values and not words:
            return (mixed or [k])[0], above[: len(above) - len(mixed)]
        above.append(k)
        mixed = [*mixed, k] * (values > words)
    raise RecordingError(f"{path}: there is no line of numbers in it")


def _head(above: list[list[str]], width: int) -> tuple[list[str], dict[str, str]]:
    """Names of all columns, each once, and their units, by the lines above the numbers."""
    stated = [[field.strip(" \"'") for field in fields] for fields in above]
    units = [fields for fields in stated if _are_units(fields)]
    others = [fields for fields in stated if fields not in units]
    given = (others or units or [[]])[-1]
    names = each_once(given, width)
    said = zip(names, units[-1] if units and others else [], strict=False)
    return names, {name: unit for name, text in said if (unit := _unit(text))}


def _unit(field: str) -> str:
    """A unit without brackets; empty if it is none."""
    bare = field.strip(" ()[]{}<>")
    return bare if plain(bare) in KNOWN else ""


def _are_units(fields: list[str]) -> bool:
    return 2 * sum(map(bool, map(_unit, fields))) > sum(map(bool, fields))


def _fields(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    if '"' in line:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    return line.split(separator)


def _bare(line: str) -> str:
    """A line without the mark of a comment."""
    return line.lstrip("#% ")


def _comment(line: str) -> bool:
    return not line.strip() or line.lstrip()[0] in "#%"


def _value(field: str) -> float:
    """A number, an instant [us], or nan where nothing is.

    Raises:
        ValueError: It is a word, or a number as only Python writes them.
    """
    if field.strip().lower() in MISSING:
        return math.nan
    try:
        return float(field.replace("_", "x"))
    except ValueError:
        return microseconds(field)


def _held(fields: Sequence[str]) -> tuple[int, int]:
    """How many fields are numbers or instants, and how many are words."""
    values = words = 0
    for field in fields:
        try:
            values += not math.isnan(_value(field))
        except ValueError:
            words += 1
    return values, words
