"""Tables of numbers in text files: CSV and similar formats, plain or compressed by gzip.

Separator and decimal point are chosen so that most fields of the table are numbers. Lines before
the first line of numbers are a preamble; the last preamble line with as many fields as the table
contains the column names, which are 0, 1, ... otherwise. A line of units next to it states the
columns' units. Columns of text are omitted, instants become microseconds (`written_times`), and
empty fields become nan. An incomplete last line is omitted.
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
    KNOWN_UNITS,
    MAX_COLUMNS,
    ForeignTable,
    canonical_unit,
    check_count,
    reading_errors_as_recording_errors,
    unique_column_names,
)
from testbed.importing.written_times import (
    DAY_MICROSECONDS,
    INSTANT_PATTERN,
    parse_instant,
)

MAX_CHARACTERS, MAX_LINES, MAX_LINE_LENGTH = 500_000_000, 5_000_000, 1_000_000
"""Largest number of characters of uncompressed text, of lines, and of characters in a line."""

MAX_PROBED_FIELDS, MAX_PROBED_LINES = 200_000, 60
"""Largest number of fields and of lines by which separator and decimal point are chosen."""

MAX_PREAMBLE_LINES = 1000
"""Largest number of lines before the first line of numbers."""

MAX_EXACT_INTEGER = 2.0**53
"""Integer up to which floating-point numbers represent all integers."""

STYLES = (
    (";", "."),
    (";", ","),
    ("\t", "."),
    ("\t", ","),
    (",", "."),
    (None, "."),
    (None, ","),
)
"""Separators and decimal points in the order of trying; None stands for blanks."""

MISSING = {"", "-", "--", "nan", "na", "n/a", "#n/a", "null", "none"}
"""Fields without a number, in lower case."""


def read_file(path: Path) -> ForeignTable:
    """Read the columns of a text file with lines of numbers below a header.

    Separator and decimal point are those with the largest share of numeric fields. Columns of text
    and an incomplete last line are omitted; instants become microseconds.

    Args:
        path: Path of the file.

    Raises:
        RecordingError: The file does not contain a table of numbers.
    """
    with reading_errors_as_recording_errors(path):
        lines, ended = _lines(path)
        numbered = [k for k, line in enumerate(lines) if not _is_comment(line)]
        probes = numbered[len(numbered) // 2 :]
        probes = probes[:: len(probes) // MAX_PROBED_LINES + 1]
        fields = 1 + max(
            (lines[k].count(mark) for k in probes for mark in ";\t,"), default=0
        )
        # decimal commas are counted too, as in 1,5;2,5
        check_count(path, "fields in a line", fields, 2 * MAX_COLUMNS)
        probes = probes[: max(1, MAX_PROBED_FIELDS // fields)]
        separator, decimal = max(
            STYLES, key=lambda style: _numeric_share([lines[k] for k in probes], *style)
        )
        original_lines = lines
        if decimal == ",":
            lines = [line.replace(",", ".") for line in lines]
        rows = [_fields(lines[k], separator) for k in probes]
        width = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
        probed_columns = [
            *zip(*(row for row in rows if len(row) == width), strict=True)
        ]
        numeric = [
            k
            for k, (values, words) in enumerate(
                map(_number_and_word_counts, probed_columns)
            )
            if values >= words
        ]
        filled = [k for k in numeric if any(map(str.strip, probed_columns[k]))]
        first, header_rows = _first_numeric_line(path, lines, separator, filled, width)
        names, units = _names_and_units(
            [
                _fields(_without_comment_mark(original_lines[k]), separator)
                for k in header_rows
            ],
            width,
        )
        used = [k for k in numeric if names[k] != str(k) or k in filled]
        instants = {
            names[k]: "us"
            for k in used
            if any(map(INSTANT_PATTERN.fullmatch, map(str.strip, probed_columns[k])))
        }
        last_fields = _fields(lines[numbered[-1]], separator)
        cut = len(last_fields) < len(_fields(lines[first], separator))
        # numbers with a fixed count of decimals: the last number may be truncated
        if not ended:
            others = [
                row for k, row in zip(probes, rows, strict=True) if k != numbered[-1]
            ]
            ends = ["".join(row[-1:]) for row in (*others, last_fields)]
            *digits, last = [len(end.partition(".")[2]) for end in ends]
            padded = any(end.endswith("0") for end in ends[:-1])
            cut |= padded and len({*digits}) == 1 and last < digits[0]
        body = [k for k in numbered[: -1 if cut else None] if k >= first]
        columns = _columns(path, lines, body, separator, {k: names[k] for k in used})

    def load(name: str) -> NDArray[Any]:
        column = columns[name]
        if isinstance(column, RecordingError):
            raise column
        if name in instants:  # times of day restart at midnight
            return column + DAY_MICROSECONDS * np.append(
                0, np.cumsum(np.diff(column) < -DAY_MICROSECONDS / 2)
            )
        return column

    shapes = dict.fromkeys(columns, (len(body),))
    return ForeignTable(path, shapes, load, units | instants, is_incomplete=cut)


def _columns(
    path: Path,
    lines: list[str],
    body: list[int],
    separator: str | None,
    names: dict[int, str],
) -> dict[str, NDArray[Any] | RecordingError]:
    """Values of columns keyed by name, or the error at a field without a number.

    Args:
        path: Path of the file.
        lines: Lines of the file.
        body: Indices of the lines of numbers.
        separator: Separator of fields; None for blanks.
        names: Column names, keyed by index of the field.

    Raises:
        RecordingError: A line ends before the last of these columns.
    """
    errors: dict[str, RecordingError] = {}

    def reader(name: str) -> Callable[[str], float]:
        """Converter for a column's fields, which is called in the order of the lines."""
        places = iter(body)

        def value(text: str) -> float:
            place = next(places)
            try:
                return _value(text)
            except ValueError:
                message = f"{path}: line {place + 1}: '{name}' is '{text.strip()}'"
                errors.setdefault(name, RecordingError(message))
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
        values = table(map(lines.__getitem__, body), usecols=[*names])
    except ValueError:
        last = max(names)
        for k in body:
            if (count := len(_fields(lines[k], separator))) <= last:
                message = f"line {k + 1} ends after {count} of {last + 1} fields"
                raise RecordingError(f"{path}: {message}") from None
        readers = {k: reader(name) for k, name in names.items()}
        values = table(
            map(lines.__getitem__, body), usecols=[*names], converters=readers
        )
    columns: dict[str, NDArray[Any] | RecordingError] = dict(
        zip(names.values(), values.T, strict=True)
    )
    large = np.nanmax(np.abs(values), axis=0, initial=0) >= MAX_EXACT_INTEGER
    for k in np.array([*names])[large].tolist():
        # values are not integers, or exceed 64 bits
        with suppress(ValueError, OverflowError):
            integers = table(
                map(lines.__getitem__, body), usecols=k, converters=int, dtype=np.int64
            )
            columns[names[k]] = integers[:, 0]
    return columns | errors


def _lines(path: Path, encoding: str = "utf-8-sig") -> tuple[list[str], bool]:
    """Lines of a text file, and True if the last line is complete.

    The length of each line is limited while reading, because a few compressed bytes can expand to a
    line that fills the memory. Encodings are tried in order, starting with UTF-8.

    Raises:
        RecordingError: The file is too large.
        ValueError: The file contains null characters.
    """
    open_text: Callable[..., TextIO] = (
        gzip.open if path.suffix.lower() == ".gz" else open
    )
    lines: list[str] = []
    total, ended = 0, True
    try:
        with open_text(path, "rt", encoding=encoding) as stream:
            while line := stream.readline(MAX_LINE_LENGTH + 1):
                lines.append(line.rstrip("\n"))
                total, ended = total + len(line), line.endswith("\n")
                check_count(
                    path, f"characters in line {len(lines)}", len(line), MAX_LINE_LENGTH
                )
                if "\0" in line:
                    raise ValueError("it is no text")
                check_count(path, "characters", total, MAX_CHARACTERS)
                check_count(path, "lines", len(lines), MAX_LINES)
    except UnicodeDecodeError as error:  # UTF-16 begins with byte 255 or 254
        next_encoding = {
            "utf-8-sig": "utf-16" if error.object[:1] in b"\xff\xfe" else "latin-1"
        }
        return _lines(path, next_encoding.get(encoding, "latin-1"))
    return lines, ended


def _numeric_share(lines: list[str], separator: str | None, decimal: str) -> float:
    """Share of numeric fields for a given separator and decimal point.

    The share is zero if lines have fewer than 1.5 fields on average, unless the separator is a
    blank.

    Args:
        lines: Lines of the table.
        separator: Separator of fields; None for blanks.
        decimal: Decimal point.
    """
    texts = [line.replace(",", ".") if decimal == "," else line for line in lines]
    fields = [field for line in texts for field in _fields(line, separator)]
    if separator is not None and 2 * len(fields) < 3 * len(lines):
        return 0.0
    values, words = _number_and_word_counts(fields)
    return values / max(1, values + words)


def _first_numeric_line(
    path: Path, lines: list[str], separator: str | None, numeric: list[int], width: int
) -> tuple[int, list[int]]:
    """Indices of the first line of numbers, and of preceding lines with enough fields.

    Lines with more numbers than words are lines of numbers too if they directly precede it.

    Args:
        path: Path of the file.
        lines: Lines of the file.
        separator: Separator of fields; None for blanks.
        numeric: Indices of the fields that are numbers.
        width: Number of fields in most lines.

    Raises:
        RecordingError: There is no line of numbers.
    """
    header_rows: list[int] = []
    mixed_rows: list[int] = []
    for k, line in enumerate(lines[:MAX_PREAMBLE_LINES]):
        fields = _fields(_without_comment_mark(line), separator)
        if (
            not numeric
            or not max(numeric) < len(fields) <= width + 1
            or not any(fields)
        ):
            continue
        values, words = (
            (0, 1)
            if _is_comment(line)
            else _number_and_word_counts([fields[j] for j in numeric])
        )
        if values and not words:
            return (mixed_rows or [k])[0], header_rows[
                : len(header_rows) - len(mixed_rows)
            ]
        header_rows.append(k)
        mixed_rows = [*mixed_rows, k] * (values > words)
    raise RecordingError(f"{path}: there is no line of numbers in it")


def _names_and_units(
    header: list[list[str]], width: int
) -> tuple[list[str], dict[str, str]]:
    """Unique column names, and units keyed by name, from the lines above the numbers.

    The last line that is not a line of units contains the names; the last line of units contains
    the units.

    Args:
        header: Fields of the lines above the numbers.
        width: Number of columns.
    """
    stated = [[field.strip(" \"'") for field in fields] for fields in header]
    units = [fields for fields in stated if _is_unit_row(fields)]
    others = [fields for fields in stated if fields not in units]
    name_fields = (others or units or [[]])[-1]
    names = unique_column_names(name_fields, width)
    unit_fields = zip(names, units[-1] if units and others else [], strict=False)
    return names, {name: unit for name, text in unit_fields if (unit := _unit(text))}


def _unit(field: str) -> str:
    """Unit without brackets; empty if the unit is not known."""
    bare = field.strip(" ()[]{}<>")
    return bare if canonical_unit(bare) in KNOWN_UNITS else ""


def _is_unit_row(fields: list[str]) -> bool:
    """Test whether most of the non-empty fields are units."""
    return 2 * sum(map(bool, map(_unit, fields))) > sum(map(bool, fields))


def _fields(line: str, separator: str | None) -> list[str]:
    """Fields of a line, with quotation marks resolved."""
    if separator is None:
        return line.split()
    if '"' in line:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    return line.split(separator)


def _without_comment_mark(line: str) -> str:
    """Line without the leading comment mark."""
    return line.lstrip("#% ")


def _is_comment(line: str) -> bool:
    """Test whether a line is empty or a comment."""
    return not line.strip() or line.lstrip()[0] in "#%"


def _value(field: str) -> float:
    """Number in a field, an instant [us], or nan for a missing number.

    Raises:
        ValueError: The field is a word, or a number in a notation that only Python has.
    """
    if field.strip().lower() in MISSING:
        return math.nan
    try:
        return float(field.replace("_", "x"))
    except ValueError:
        return parse_instant(field)


def _number_and_word_counts(fields: Sequence[str]) -> tuple[int, int]:
    """Number of fields that contain numbers or instants, and number of words.

    Fields for missing numbers are ignored.
    """
    values = words = 0
    for field in fields:
        try:
            values += not math.isnan(_value(field))
        except ValueError:
            words += 1
    return values, words
