"""What a foreign file holds: columns by name, read when they are asked for.

A reader knows a format and nothing of robots: it says which arrays there are and how to get
one. Arrays of several columns are cut into columns here, the same for all formats.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, UnknownName
from testbed.importing.vocabulary import TABLES, by_word

Kind = Literal["position", "velocity", "acceleration", "torque", "temperature"]
KINDS: tuple[Kind, ...] = ("position", "velocity", "acceleration", "torque")
"""What is measured of a joint's motion and of what moves it."""

SIZES: Mapping[str, dict[str, float]] = TABLES["sizes"]
ANGLES, LENGTHS, FORCES = SIZES["angles"], SIZES["lengths"], SIZES["forces"]
MOMENTS, TIMES = SIZES["moments"], SIZES["times"]
RAW = SIZES["raw"]
"""Of what becomes a torque by a gain."""


def _units_of_joint(
    position: dict[str, float], torque: dict[str, float]
) -> dict[str, dict[str, float]]:
    """Units of a joint's signals, by those of its positions and of its torques."""
    derivatives = (
        {f"{unit}{per}": size for unit, size in position.items()}
        for per in ("/s", "/s^2")
    )
    return dict(zip(KINDS, (position, *derivatives, torque), strict=True))


TURNING, SLIDING = _units_of_joint(ANGLES, MOMENTS), _units_of_joint(LENGTHS, FORCES)
TURNING["velocity"].update(rpm=math.pi / 30)

UNITS = {kind: TURNING[kind] | SLIDING[kind] for kind in KINDS} | {
    "force": FORCES,
    "moment": MOMENTS,
    "temperature": {"degC": 1.0},
}
"""By what is measured: what one of each is in SI."""

KNOWN = {name for units in UNITS.values() for name in units} | RAW.keys() | TIMES.keys()

WORDS, WHOLE = by_word("units"), by_word("whole_units")
"""Other ways to write words of units, and whole units."""


def plain(unit: str) -> str:
    """A unit as it is written here: in-lbf, N·m, °/s and the like are known.

    Args:
        unit: As a person or a file writes it.
    """
    short = " ".join(unit.split())
    if short in KNOWN:
        return short
    text = short.replace("°", "deg").replace("µ", "u").replace("μ", "u")
    text = re.sub(r"\s+s\^?-([12])$", r"/s^\1", text).replace("s^1", "s")
    parts = [_product(part) for part in re.split(r"\s*/\s*|\s+per\s+", text)]
    found = "/".join(parts)
    found = WHOLE.get(found, found)
    return found if found in KNOWN else short


def _product(text: str) -> str:
    """Factors of a unit, a force before its arm."""
    given = re.split(r"[\s*·⋅.\-_]+", text)
    plainer = [
        word.lower() if len(word) > 2 and word not in WORDS else word for word in given
    ]
    words = [WORDS.get(word, word) for word in plainer]
    return " ".join(sorted(words, key=lambda word: word not in FORCES))


def check_unit(kind: str, unit: str, *, gained: bool = False) -> None:
    """Whether a unit is one of what is measured.

    Args:
        kind: What is measured, a key of `UNITS`.
        unit: As a person writes it.
        gained: Whether a gain makes a torque of it.

    Raises:
        ValueError: It is not.
    """
    if gained and kind != "torque":
        raise ValueError(f"{kind}.gain: gains are for torques")
    known = RAW if gained else UNITS[kind]
    if plain(unit) in known:
        return
    if plain(unit) in RAW and kind == "torque":
        raise ValueError(
            f"torque.unit: '{unit}' is no torque; say `gain`, how much one makes [N m]"
        )
    said = UnknownName(f"unit of {kind}{' with a gain' if gained else ''}", unit, known)
    raise ValueError(str(said))


def factor(kind: str, unit: str) -> float:
    """What one of a unit is in SI; one of a raw unit is itself.

    Args:
        kind: What is measured, a key of `UNITS`.
        unit: One that `check_unit` takes.
    """
    return (RAW | UNITS[kind])[plain(unit)]


def slides(unit: str) -> bool:
    """Whether a position in this unit is of a joint that slides."""
    return plain(unit) in LENGTHS


MOST_NUMBERS = 100_000_000
"""That are held in memory at once: an import is made in memory."""

MOST_COLUMNS = 10_000
"""Of a table, and of each of its arrays: what has more is no table of samples."""

NUMBERS = "fiub"
"""Kinds of NumPy's types that are real numbers."""


@dataclass(frozen=True)
class StatedPlate:
    """A force plate as a file describes it.

    Attributes:
        name: Of a table in a mapping.
        columns: Force and moment on the plate along the sensor's axes, or what becomes them.
        place: `xyz` [m] and `rpy` [rad] of the sensor in the laboratory's frame; None if unknown.
        matrix: (6, k), from the columns to forces [N] and moments [N m]; None if they are those.
    """

    name: str
    columns: tuple[str, ...]
    place: Mapping[str, list[float]] | None = None
    matrix: list[list[float]] | None = None


@dataclass(frozen=True, eq=False)
class ForeignTable:
    """Columns of a file, by name; they need not be of one length.

    An array of one axis is a column of its name. Of an array of two axes the longer one is
    that of the samples, and its columns are NAME[0], NAME[1], ...

    Attributes:
        path: The file.
        shapes: Of the arrays that hold numbers, by name.
        load: Gives an array by name.
        units: What the file says of columns' or arrays' units, as it says it.
        cut: Whether a last sample was incomplete and is left out.
        plates: Force plates that the file describes.
    """

    path: Path
    shapes: Mapping[str, tuple[int, ...]]
    load: Callable[[str], Any]
    units: Mapping[str, str] = field(default_factory=dict)
    cut: bool = False
    plates: Sequence[StatedPlate] = ()

    def __post_init__(self) -> None:
        """Refuse a table of more than `MOST_COLUMNS`.

        Raises:
            RecordingError: It has more.
        """
        check_count(
            self.path, "columns", sum(map(_width, self.shapes.values())), MOST_COLUMNS
        )

    @staticmethod
    def of(
        path: Path, arrays: Mapping[str, NDArray[Any]], units: Mapping[str, str]
    ) -> ForeignTable:
        """Table of arrays that are in memory, with their units."""
        shapes = {name: values.shape for name, values in arrays.items()}
        return ForeignTable(path, shapes, arrays.__getitem__, units)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(self._places)

    @cached_property
    def lengths(self) -> dict[str, int]:
        """Number of samples of every column, by name."""
        return {
            name: max(self.shapes[array]) for name, (array, _) in self._places.items()
        }

    def unit(self, column: str) -> str | None:
        """What the file says of a column's unit; None if nothing."""
        array = self._places[column][0]
        return self.units.get(column, self.units.get(array))

    def read(self, columns: Iterable[str]) -> dict[str, Array]:
        """Some columns, (M,) each.

        Args:
            columns: Their names.

        Raises:
            UnknownName: There is no such column.
            RecordingError: The file is damaged there, or holds too much.
        """
        return {
            k: np.array(row, dtype=np.float64) for k, row in self._rows(columns).items()
        }

    def matrix(self, columns: Sequence[str]) -> Array:
        """Some columns of one length side by side, (M, k).

        Args:
            columns: Their names.

        Raises:
            UnknownName: There is no such column.
            RecordingError: The file is damaged there, or holds too much.
        """
        read = self.read(columns)
        return np.stack([read[name] for name in columns], axis=1)

    def _rows(self, columns: Iterable[str]) -> dict[str, NDArray[Any]]:
        """Rows of the given columns, (M, k)."""
        places, wanted = self._places, list(columns)
        for name in wanted:
            if name not in places:
                raise UnknownName(f"column of '{self.path}'", name, places)
        arrays = dict.fromkeys(places[name][0] for name in wanted)
        count = sum(math.prod(self.shapes[array]) for array in arrays)
        check_count(self.path, "numbers", count, MOST_NUMBERS)
        with readable(self.path):
            loaded = {array: self._loaded(array) for array in arrays}
        return {name: loaded[places[name][0]][places[name][1]] for name in wanted}

    def stamps(self, column: str) -> Array | NDArray[np.int64]:
        """A column as it is counted, (M,): whole numbers stay whole.

        Nanoseconds since 1970 have more digits than floating-point numbers.

        Args:
            column: Its name.

        Raises:
            UnknownName: There is no such column.
            RecordingError: The file is damaged there, or holds too much.
        """
        kept = self._rows([column])[column]
        whole = kept.dtype.kind in "iu"
        return kept.astype(np.int64) if whole else kept.astype(np.float64)

    def _loaded(self, name: str) -> NDArray[Any]:
        """An array as columns, (k, M)."""
        found = np.asarray(self.load(name))
        if found.shape != self.shapes[name] or found.dtype.kind not in NUMBERS:
            raise ValueError(f"'{name}' is not what the file says of it")
        found = np.atleast_2d(found)
        rows, columns = found.shape
        return found.T if rows >= columns else found  # rows are samples

    @cached_property
    def _places(self) -> dict[str, tuple[str, int]]:
        """Array and row among its columns, by the column's name."""
        found = {}
        for name, shape in self.shapes.items():
            if (count := _width(shape)) == 1:
                found[name] = (name, 0)
            else:
                found |= {f"{name}[{k}]": (name, k) for k in range(count)}
        return found


Tables = dict[str, ForeignTable | RecordingError | UnknownName]
"""Of a file that holds several, by topic; or why one cannot be read."""


def is_column(shape: tuple[int, ...], kind: str) -> bool:
    """Whether an array can be columns.

    Args:
        shape: Of the array.
        kind: Of its type, as NumPy says it.
    """
    fits = 1 <= len(shape) <= 2 and 1 <= _width(shape) <= MOST_COLUMNS
    return kind in NUMBERS and fits and max(shape) > 1


def _width(shape: tuple[int, ...]) -> int:
    """Number of columns of an array; the longer axis is that of the samples."""
    return min(shape) if len(shape) == 2 else 1


def check_count(path: Path, what: str, count: int, most: int) -> None:
    """Refuse a file that holds more than an import takes.

    Args:
        path: The file or folder.
        what: Is counted: columns, lines.
        count: Found.
        most: Taken.

    Raises:
        RecordingError: There are more.
    """
    if count > most:
        raise RecordingError(
            f"{path}: {count} {what}, and an import takes at most {most}: is this a recording? "
            "Write the signals of the robot alone into a file, or cut it into parts"
        )


def each_once(names: Sequence[str], count: int) -> list[str]:
    """Names of columns, each once: the second of a kind with its place behind it.

    Args:
        names: As they are given; a column without one is called by its place.
        count: Of columns.
    """
    found: dict[str, None] = {}
    for k in range(count):
        name = (names[k] if k < len(names) else "") or str(k)
        while name in found:
            name += f" ({k})"
        found[name] = None
    return [*found]


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Whatever a library finds wrong with a file, as one error.

    Raises:
        RecordingError: Says what.
    """
    try:
        yield
    except (RecordingError, UnknownName, MemoryError):
        raise
    except Exception as error:  # libraries raise whatever a damaged file makes them
        raise refusal(path, error) from None


def refusal(path: Path, error: Exception) -> RecordingError | UnknownName:
    """What a library finds wrong with a file, as an error for people.

    Args:
        path: The file.
        error: Whatever was raised.
    """
    if isinstance(error, RecordingError | UnknownName):
        return error
    said = " ".join(str(error).split())
    plain = isinstance(error, ValueError | OSError) and said
    reason = said if plain else f"it is damaged ({type(error).__name__}: {said})"
    return RecordingError(f"{path}: not readable: {reason}")


@contextmanager
def library(name: str) -> Iterator[None]:
    """What only some users need is said where it is missing.

    Args:
        name: The package.

    Raises:
        RecordingError: It is not installed.
    """
    try:
        yield
    except ImportError:
        raise RecordingError(
            f"this format needs the package {name}, which is not installed: "
            "pip install '.[import]' in the project's folder"
        ) from None
