"""Numbers in lines of text: CSV and its relatives, plain or packed by gzip.

The style, separator and decimal point, is that by which most fields of the table are numbers.
Lines before the first one of numbers are a preamble; the last of them that has as many fields
names the columns, else they are called 0, 1, .... A line of units beside it is that of the
columns' units. Columns of text are left out, instants are nanoseconds (`written_times`), empty
fields are no numbers (nan). A last line that is incomplete is left out.
"""

from __future__ import annotations

import csv
import gzip
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.recordings.importing.foreign_table import KNOWN, ForeignTable, plain, readable
from testbed.recordings.importing.written_times import is_instant, nanoseconds

MOST_TEXT = 500_000_000
"""Bytes of text, unpacked."""

LONGEST_PREAMBLE = 1000
"""Lines before the first one of numbers."""

LOOKED_AT = 60
"""Lines by which a table's style is known."""

AT_ONCE = 50_000
"""Lines that are split at a time."""

WHOLE = 2.0**53
"""From here on floating-point numbers leave out whole ones."""

STYLES = tuple((separator, decimal) for separator in (";", "\t", ",", None) for decimal in ".,")
"""Separators and decimal points in the order of trying; no separator is blanks."""

MISSING = {"", "-", "--", "nan", "na", "n/a", "#n/a", "null", "none"}
"""Fields without a number, in small letters."""


@dataclass(frozen=True)
class _Style:
    """How a table is written.

    Attributes:
        separator: Between fields; None for blanks.
        decimal: The decimal point.
        width: Fields of a line.
        filled: Number of the first fields that are not all empty.
        kinds: By its place, what a column holds: "number" or "instant".
    """

    separator: str | None
    decimal: str
    width: int
    filled: int
    kinds: dict[int, str]

    def words(self, fields: Sequence[str]) -> int:
        """How many fields of columns that are read hold neither their kind nor nothing."""
        pairs = ((kind, fields[k]) for k, kind in self.kinds.items())
        return sum(_kind(text, self.decimal) not in (kind, "") for kind, text in pairs)

    def given(self, fields: Sequence[str]) -> int:
        """How many fields of columns that are read hold their kind."""
        return sum(_kind(fields[k], self.decimal) == kind for k, kind in self.kinds.items())


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
        style = _style(path, lines)
        first, before = _first_numbers(path, lines, style)
        names, units = _head(before, style)
        lines, cut = _without_cut_end(lines, first, style)
        columns = _columns(path, lines, first, style, names)

    def load(name: str) -> NDArray[Any]:
        found = columns[name]
        if isinstance(found, RecordingError):
            raise found
        return found

    count = max((len(c) for c in columns.values() if not isinstance(c, Exception)), default=2)
    return ForeignTable(path, dict.fromkeys(columns, (count,)), load, units, cut=cut)


def _columns(
    path: Path, lines: list[str], first: int, style: _Style, names: dict[int, str]
) -> dict[str, NDArray[Any] | RecordingError]:
    """Columns by name, or which line is no number in them."""
    parts: dict[int, list[Any]] = {k: [] for k in names}
    refused: dict[int, RecordingError] = {}
    told = ((k, line) for k, line in enumerate(lines[first:], first + 1) if not _comment(line))
    while chunk := [*islice(told, AT_ONCE)]:
        numbers = [k for k in names if style.kinds[k] == "number"]
        plain_ones = _plain_numbers([line for _, line in chunk], style, numbers)
        for k, values in plain_ones.items():
            parts[k].append(values)
        if len(plain_ones) == len(names):
            continue
        rows = [_fields(line, style.separator) for _, line in chunk]
        for (number, _), fields in zip(chunk, rows, strict=True):
            if len(fields) <= max(names):
                raise RecordingError(
                    f"{path}: line {number} ends after {len(fields)} of {max(names) + 1} fields"
                )
        for k in names.keys() - plain_ones.keys():
            texts, kind = [fields[k] for fields in rows], style.kinds[k]
            try:
                parts[k] += _checked(texts) if kind == "instant" else [_values(texts, style)]
            except ValueError:
                wrong = [_kind(text, style.decimal) not in (kind, "") for text in texts].index(True)
                said = f"line {chunk[wrong][0]}: '{names[k]}' is '{texts[wrong].strip()}'"
                refused.setdefault(k, RecordingError(f"{path}: {said}"))
    made = {}
    for k, name in names.items():
        whole = nanoseconds if style.kinds[k] == "instant" else np.concatenate
        made[name] = refused.get(k) or whole(parts[k])
    return made


def _plain_numbers(lines: list[str], style: _Style, places: list[int]) -> dict[int, Array]:
    """Columns of lines in which every field of these is a number; else none of them."""
    if style.decimal == ",":
        lines = [line.replace(",", ".") for line in lines]
    try:
        table = np.loadtxt(lines, delimiter=style.separator, usecols=places, comments=None, ndmin=2)
    except ValueError:
        return {}
    large = np.abs(table).max(axis=0, initial=0) >= WHOLE
    return {k: table[:, place] for place, k in enumerate(places) if not large[place]}


def _checked(texts: list[str]) -> list[str]:
    """Instants, empty where one is missing.

    Raises:
        ValueError: A text is none.
    """
    found = ["" if _missing(text) else text for text in texts]
    if not all(is_instant(text) for text in found if text):
        raise ValueError("no instant")
    return found


def _values(texts: list[str], style: _Style) -> NDArray[Any]:
    """Numbers of one column; whole ones that are too large for floating point stay whole.

    Raises:
        ValueError: A text is none.
    """
    given = [text.replace(",", ".") for text in texts] if style.decimal == "," else texts
    try:
        found: Array = np.array([float(text) for text in given])
    except ValueError:
        found = np.array([float("nan" if _missing(text) else text) for text in given])
    if any("_" in text for text in given):  # a number of Python's, and of no logger's
        raise ValueError("no number")
    if np.abs(found).max(initial=0) >= WHOLE:
        try:
            return np.array([int(text) for text in given], dtype=np.int64)
        except (ValueError, OverflowError):  # no whole numbers, or more than counters hold
            return found
    return found


def _without_cut_end(lines: list[str], first: int, style: _Style) -> tuple[list[str], bool]:
    """The lines without a last one that is incomplete, as where a logger was stopped."""
    last = max(k for k, line in enumerate(lines) if not _comment(line))
    fields = [len(_fields(lines[k], style.separator)) for k in (first, last)]
    return (lines[:last], True) if fields[1] < fields[0] else (lines, False)


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


def _style(path: Path, lines: list[str]) -> _Style:
    """How the table is written, by lines of its second half.

    Raises:
        RecordingError: They hold no numbers.
    """
    told = [line for line in lines if not _comment(line)]
    told = told[len(told) // 2 :]
    told = told[:: len(told) // LOOKED_AT + 1]

    def share(style: tuple[str | None, str]) -> float:
        rows = [_fields(line, style[0]) for line in told]
        kinds = [_kind(field, style[1]) for row in rows for field in row]
        given = [kind for kind in kinds if kind]
        alone = style[0] is not None and len(kinds) < 2 * len(rows)
        return 0.0 if alone or not given else 1 - given.count("word") / len(given)

    separator, decimal = max(STYLES, key=share)
    rows = [_fields(line, separator) for line in told]
    width = Counter(len(row) for row in rows).most_common(1)[0][0] if rows else 0
    held = [
        Counter(_kind(row[k], decimal) for row in rows if len(row) == width) for k in range(width)
    ]
    filled = max((k + 1 for k, each in enumerate(held) if {*each} - {""}), default=0)
    kinds = {k: max(("number", "instant", "word"), key=each.__getitem__)
             for k, each in enumerate(held)}  # fmt: skip
    read = {k: kind for k, kind in kinds.items() if kind != "word"}
    if not filled or not read:
        raise RecordingError(f"{path}: there is no line of numbers in it")
    return _Style(separator, decimal, width, filled, read)


def _first_numbers(path: Path, lines: list[str], style: _Style) -> tuple[int, list[list[str]]]:
    """Index of the first line of numbers, and fields of the lines before that fit the columns."""
    before: list[list[str]] = []
    for k, line in enumerate(lines[:LONGEST_PREAMBLE]):
        fields = _fields(line.lstrip("#% ") if _comment(line) else line, style.separator)
        used = max((i + 1 for i, field in enumerate(fields) if field.strip()), default=0)
        if not min(style.filled, style.width) <= len(fields) or used > style.width:
            continue
        fields += [""] * (style.width - len(fields))
        words, given = style.words(fields), style.given(fields)
        if not _comment(line) and given and (not words or (before and given > words)):
            return k, before
        if used:
            before.append(fields)
    raise RecordingError(f"{path}: there is no line of numbers in it")


def _head(before: list[list[str]], style: _Style) -> tuple[dict[int, str], dict[str, str]]:
    """Names of the columns that are read, each once, and their units, by the lines above."""
    of_units = [fields for fields in before if _are_units(fields)]
    of_names = [fields for fields in before if fields not in of_units] or of_units
    given = of_names[-1] if of_names else [""] * style.width
    names: list[str] = []
    for k, text in enumerate(given):
        name = text.strip().strip("\"'").strip() or str(k)
        names.append(name if name not in names else f"{name} ({k})")
    named = {k: names[k] for k in style.kinds if k < style.filled or given[k].strip()}
    said = of_units[-1] if of_units and of_names is not of_units else []
    units = {name: unit for k, name in named.items() if said and (unit := _unit(said[k]))}
    return named, units | {named[k]: "ns" for k in named if style.kinds[k] == "instant"}


def _unit(field: str) -> str:
    """A unit without brackets and quotes."""
    return field.strip(" \"'()[]{}<>")


def _are_units(fields: list[str]) -> bool:
    given = [unit for field in fields if (unit := _unit(field))]
    return 2 * sum(plain(unit) in KNOWN for unit in given) > len(given)


def _fields(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    if '"' in line:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    return line.split(separator)


def _comment(line: str) -> bool:
    return not line.strip() or line.lstrip()[0] in "#%"


def _missing(field: str) -> bool:
    return field.strip().lower() in MISSING


def _kind(field: str, decimal: str) -> str:
    """What a field holds: "number", "instant", "word", or nothing."""
    if _missing(field):
        return ""
    try:
        float(field.replace(",", ".") if decimal == "," else field)
    except ValueError:
        return "instant" if is_instant(field) else "word"
    return "word" if "_" in field else "number"
