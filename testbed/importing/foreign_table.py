"""Columns of a foreign file by name, loaded on demand.

The reader of a format lists and loads the arrays in a file, without regard to robots. This module
splits the arrays into columns, in the same way for all formats.
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
from testbed.importing.vocabulary import WORD_TABLES, keys_by_word

JointQuantity = Literal["position", "velocity", "acceleration", "torque", "temperature"]
"""Quantity measured at each joint."""
JOINT_QUANTITIES: tuple[JointQuantity, ...] = (
    "position",
    "velocity",
    "acceleration",
    "torque",
)
"""Quantities of a joint's motion, and its torque."""

UNIT_SIZES: Mapping[str, dict[str, float]] = WORD_TABLES["sizes"]
ANGLE_UNITS, LENGTH_UNITS, FORCE_UNITS = (
    UNIT_SIZES["angles"],
    UNIT_SIZES["lengths"],
    UNIT_SIZES["forces"],
)
MOMENT_UNITS, TIME_UNITS = UNIT_SIZES["moments"], UNIT_SIZES["times"]
RAW_UNITS = UNIT_SIZES["raw"]
"""Units of quantities that a gain turns into a torque."""


def _units_of_joint(
    position: dict[str, float], torque: dict[str, float]
) -> dict[str, dict[str, float]]:
    """Units of position, velocity, acceleration and torque of a joint, with sizes in SI."""
    derivatives = (
        {f"{unit}{per}": size for unit, size in position.items()}
        for per in ("/s", "/s^2")
    )
    return dict(zip(JOINT_QUANTITIES, (position, *derivatives, torque), strict=True))


REVOLUTE_UNITS, PRISMATIC_UNITS = (
    _units_of_joint(ANGLE_UNITS, MOMENT_UNITS),
    _units_of_joint(LENGTH_UNITS, FORCE_UNITS),
)
REVOLUTE_UNITS["velocity"].update(rpm=math.pi / 30)

UNITS_BY_QUANTITY = {
    kind: REVOLUTE_UNITS[kind] | PRISMATIC_UNITS[kind] for kind in JOINT_QUANTITIES
} | {
    "force": FORCE_UNITS,
    "moment": MOMENT_UNITS,
    "temperature": {"degC": 1.0},
}
"""Units by quantity, with their sizes in SI."""

KNOWN_UNITS = (
    {name for units in UNITS_BY_QUANTITY.values() for name in units}
    | RAW_UNITS.keys()
    | TIME_UNITS.keys()
)

UNIT_WORD_OF_SYNONYM, UNIT_OF_SYNONYM = (
    keys_by_word("units"),
    keys_by_word("whole_units"),
)
"""Words of units by their synonyms, and whole units by theirs."""


def canonical_unit(unit: str) -> str:
    """Unit in the package's notation, converted from in-lbf, N·m, °/s and similar notations.

    An unknown unit is returned unchanged, except for blanks.

    Args:
        unit: Unit as written by a user or in a file.
    """
    short = " ".join(unit.split())
    if short in KNOWN_UNITS:
        return short
    text = short.replace("°", "deg").replace("µ", "u").replace("μ", "u")
    text = re.sub(r"\s+s\^?-([12])$", r"/s^\1", text).replace("s^1", "s")
    parts = [_factors(part) for part in re.split(r"\s*/\s*|\s+per\s+", text)]
    unit_text = "/".join(parts)
    unit_text = UNIT_OF_SYNONYM.get(unit_text, unit_text)
    return unit_text if unit_text in KNOWN_UNITS else short


def _factors(text: str) -> str:
    """Product of unit words in the package's notation, with forces before lengths."""
    factors = re.split(r"[\s*·⋅.\-_]+", text)
    normalised = [
        word.lower() if len(word) > 2 and word not in UNIT_WORD_OF_SYNONYM else word
        for word in factors
    ]
    factors = [UNIT_WORD_OF_SYNONYM.get(word, word) for word in normalised]
    return " ".join(sorted(factors, key=lambda word: word not in FORCE_UNITS))


def check_unit(kind: str, unit: str, *, with_gain: bool = False) -> None:
    """Check that a unit belongs to a quantity.

    Args:
        kind: Quantity, a key of `UNITS_BY_QUANTITY`.
        unit: Unit as written by the user.
        with_gain: True if a gain turns the quantity into a torque.

    Raises:
        ValueError: The unit does not belong to the quantity.
    """
    if with_gain and kind != "torque":
        raise ValueError(f"{kind}.gain: gains are for torques")
    known = RAW_UNITS if with_gain else UNITS_BY_QUANTITY[kind]
    if canonical_unit(unit) in known:
        return
    if canonical_unit(unit) in RAW_UNITS and kind == "torque":
        raise ValueError(
            f"torque.unit: '{unit}' is no torque; say `gain`, how much one makes [N m]"
        )
    error = UnknownName(
        f"unit of {kind}{' with a gain' if with_gain else ''}", unit, known
    )
    raise ValueError(str(error))


def unit_size(kind: str, unit: str) -> float:
    """Size of a unit in SI; for raw units, the value of the prefix (1e-3 for mA).

    Args:
        kind: Quantity, a key of `UNITS_BY_QUANTITY`.
        unit: Unit that `check_unit` accepts.
    """
    return (RAW_UNITS | UNITS_BY_QUANTITY[kind])[canonical_unit(unit)]


def is_length_unit(unit: str) -> bool:
    """Test whether a unit of position is a length, as for a prismatic joint.

    Args:
        unit: Unit of a position.
    """
    return canonical_unit(unit) in LENGTH_UNITS


MAX_NUMBERS = 100_000_000
"""Largest number of values in memory at once."""

MAX_COLUMNS = 10_000
"""Largest number of columns of a table, and of each array."""

REAL_DTYPE_KINDS = "fiub"
"""Kinds of NumPy dtypes that are real numbers."""


@dataclass(frozen=True)
class DescribedPlate:
    """Force plate as described in a file.

    Attributes:
        name: Name for the plate's table in a mapping.
        columns: Columns of force and moment on the plate along the sensor's axes, or channels from
            which `matrix` computes force and moment.
        sensor_pose: Pose `xyz` [m] and `rpy` [rad] of the sensor in the laboratory frame; None if
            unknown.
        matrix: Calibration matrix from columns to forces [N] and moments [N m], (6, k); None if the
            columns are forces and moments.
    """

    name: str
    columns: tuple[str, ...]
    sensor_pose: Mapping[str, list[float]] | None = None
    matrix: list[list[float]] | None = None


@dataclass(frozen=True, eq=False)
class ForeignTable:
    """Columns of a foreign file by name; their lengths may differ.

    A one-dimensional array is a column with the array's name. In a two-dimensional array, the
    longer axis runs over samples, and the columns are NAME[0], NAME[1], ...

    Attributes:
        path: Path of the file.
        shapes: Shapes of the numeric arrays, keyed by name.
        load_array: Function that loads an array, given its name.
        units: Units that the file states, keyed by column or array, in the file's notation.
        is_incomplete: True if an incomplete last sample was omitted.
        plates: Force plates that the file describes.
    """

    path: Path
    shapes: Mapping[str, tuple[int, ...]]
    load_array: Callable[[str], Any]
    units: Mapping[str, str] = field(default_factory=dict)
    is_incomplete: bool = False
    plates: Sequence[DescribedPlate] = ()

    def __post_init__(self) -> None:
        """Refuse a table of more than `MAX_COLUMNS` columns.

        Raises:
            RecordingError: The table has more columns.
        """
        check_count(
            self.path, "columns", sum(map(_width, self.shapes.values())), MAX_COLUMNS
        )

    @staticmethod
    def table_from_arrays(
        path: Path, arrays: Mapping[str, NDArray[Any]], units: Mapping[str, str]
    ) -> ForeignTable:
        """Table of arrays in memory.

        Args:
            path: File from which the arrays were read.
            arrays: Numeric arrays, keyed by name.
            units: Units, keyed by array.
        """
        shapes = {name: values.shape for name, values in arrays.items()}
        return ForeignTable(path, shapes, arrays.__getitem__, units)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(self._column_locations)

    @cached_property
    def lengths(self) -> dict[str, int]:
        """Number of samples of each column, keyed by name."""
        return {
            name: max(self.shapes[array])
            for name, (array, _) in self._column_locations.items()
        }

    def unit(self, column: str) -> str | None:
        """Unit that the file states for a column; None if the file states no unit.

        Args:
            column: Column name.
        """
        array = self._column_locations[column][0]
        return self.units.get(column, self.units.get(array))

    def column_values(self, columns: Iterable[str]) -> dict[str, Array]:
        """Values of the given columns, keyed by name, (M,) each.

        Args:
            columns: Column names.

        Raises:
            UnknownName: A column does not exist.
            RecordingError: The data of a column are damaged, or there are too many numbers.
        """
        return {
            k: np.array(row, dtype=np.float64)
            for k, row in self._column_arrays(columns).items()
        }

    def matrix(self, columns: Sequence[str]) -> Array:
        """Values of columns of equal length, side by side, (M, k).

        Args:
            columns: Column names.

        Raises:
            UnknownName: A column does not exist.
            RecordingError: The data of a column are damaged, or there are too many numbers.
        """
        read = self.column_values(columns)
        return np.stack([read[name] for name in columns], axis=1)

    def _column_arrays(self, columns: Iterable[str]) -> dict[str, NDArray[Any]]:
        """Values of columns in the dtype of the file, keyed by name, (M,) each."""
        locations, names = self._column_locations, list(columns)
        for name in names:
            if name not in locations:
                raise UnknownName(f"column of '{self.path}'", name, locations)
        arrays = dict.fromkeys(locations[name][0] for name in names)
        count = sum(math.prod(self.shapes[array]) for array in arrays)
        check_count(self.path, "numbers", count, MAX_NUMBERS)
        with reading_errors_as_recording_errors(self.path):
            loaded = {array: self._array_columns(array) for array in arrays}
        return {name: loaded[locations[name][0]][locations[name][1]] for name in names}

    def time_stamps(self, column: str) -> Array | NDArray[np.int64]:
        """Time stamps of a column, (M,), as integers if the file holds integers.

        Nanoseconds since 1970 have more digits than a floating-point number can hold.

        Args:
            column: Column name.

        Raises:
            UnknownName: The column does not exist.
            RecordingError: The data of the column are damaged, or there are too many numbers.
        """
        values = self._column_arrays([column])[column]
        is_integer = values.dtype.kind in "iu"
        return values.astype(np.int64) if is_integer else values.astype(np.float64)

    def _array_columns(self, name: str) -> NDArray[Any]:
        """Array loaded from the file, with one row for each column, (k, M).

        Raises:
            ValueError: The array is not numeric, or its shape differs from `shapes`.
        """
        array = np.asarray(self.load_array(name))
        if array.shape != self.shapes[name] or array.dtype.kind not in REAL_DTYPE_KINDS:
            raise ValueError(f"'{name}' differs from its description in the file")
        array = np.atleast_2d(array)
        rows, columns = array.shape
        return array.T if rows >= columns else array  # rows are samples

    @cached_property
    def _column_locations(self) -> dict[str, tuple[str, int]]:
        """Array name and index of the column in that array, keyed by column name."""
        locations = {}
        for name, shape in self.shapes.items():
            if (count := _width(shape)) == 1:
                locations[name] = (name, 0)
            else:
                locations |= {f"{name}[{k}]": (name, k) for k in range(count)}
        return locations


TablesByTopic = dict[str, ForeignTable | RecordingError | UnknownName]
"""Tables of a file by topic, or the error for a table that cannot be read."""


def is_column_array(shape: tuple[int, ...], kind: str) -> bool:
    """Test whether an array's shape and dtype permit splitting it into columns.

    The array must have real numbers, one or two axes, two samples or more, and at most
    `MAX_COLUMNS` columns.

    Args:
        shape: Shape of the array.
        kind: Kind of its NumPy dtype, a character.
    """
    fits = 1 <= len(shape) <= 2 and 1 <= _width(shape) <= MAX_COLUMNS
    return kind in REAL_DTYPE_KINDS and fits and max(shape) > 1


def _width(array_shape: tuple[int, ...]) -> int:
    """Number of columns of an array; the longer axis runs over samples."""
    return min(array_shape) if len(array_shape) == 2 else 1


def check_count(path: Path, items: str, count: int, maximum: int) -> None:
    """Refuse a file with more items than an import accepts.

    Args:
        path: File or folder.
        items: Name of the items, for example columns or lines.
        count: Number of items.
        maximum: Largest accepted number.

    Raises:
        RecordingError: The number of items exceeds the maximum.
    """
    if count > maximum:
        raise RecordingError(
            f"{path}: {count} {items}, and an import takes at most {maximum}: is this a recording? "
            "Write the signals of the robot alone into a file, or cut it into parts"
        )


def unique_column_names(names: Sequence[str], count: int) -> list[str]:
    """Unique names of columns; a repeated name gets its index as a suffix.

    Args:
        names: Names in the file; a column without a name is named by its index.
        count: Number of columns.
    """
    unique: dict[str, None] = {}
    for k in range(count):
        name = (names[k] if k < len(names) else "") or str(k)
        while name in unique:
            name += f" ({k})"
        unique[name] = None
    return [*unique]


@contextmanager
def reading_errors_as_recording_errors(path: Path) -> Iterator[None]:
    """Convert an exception of a library that reads a file to a `RecordingError`.

    Args:
        path: File that is read in the context.

    Raises:
        RecordingError: The library raised an exception.
    """
    try:
        yield
    except (RecordingError, UnknownName, MemoryError):
        raise
    except Exception as error:  # damaged files cause exceptions of any type
        raise reading_error(path, error) from None


def reading_error(path: Path, error: Exception) -> RecordingError | UnknownName:
    """Error for an exception of a library that reads a file.

    Args:
        path: Path of the file.
        error: Exception of the library; returned unchanged if it is an error of this package.
    """
    if isinstance(error, RecordingError | UnknownName):
        return error
    message = " ".join(str(error).split())
    is_readable = isinstance(error, ValueError | OSError) and message
    reason = (
        message if is_readable else f"it is damaged ({type(error).__name__}: {message})"
    )
    return RecordingError(f"{path}: not readable: {reason}")


@contextmanager
def optional_package(name: str) -> Iterator[None]:
    """Raise an error with an instruction if an optional package is not installed.

    Args:
        name: Package that is imported in the context.

    Raises:
        RecordingError: The package is not installed.
    """
    try:
        yield
    except ImportError:
        raise RecordingError(
            f"this format needs the package {name}, which is not installed: "
            "pip install '.[import]' in the project's folder"
        ) from None
