"""Content of a mapping file: columns of foreign files that become signals of a recording.

The file is in TOML format. Units, the sense of the wrench, the clock of each source and the rate of
the recording have no default. An unknown key is an error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, model_validator

from testbed.core.base.arrays import Array
from testbed.core.base.errors import ExperimentError, count_with_noun
from testbed.core.base.toml_text import (
    STRICT_TABLE,
    Finite,
    NotNegative,
    Positive,
    read_toml,
    validate_tables,
)
from testbed.core.robot.gravity import GRAVITY_BY_MOUNTING, parse_gravity
from testbed.importing.foreign_table import JOINT_QUANTITIES, check_unit, is_length_unit


def _printable(name: str) -> str:
    """Return a name unchanged if all its characters are printable.

    Raises:
        ValueError: A character is not printable.
    """
    if not name.isprintable():
        raise ValueError("it is no name")
    return name


Numbers = Annotated[list[Finite], Field(min_length=1, max_length=1000)]
Matrix = Annotated[list[Numbers], Field(min_length=1, max_length=1000)]
Vector3 = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Vector6 = Annotated[list[Finite], Field(min_length=6, max_length=6)]
Name = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_printable)]
Sign = Literal[1, -1]
Columns = Annotated[list[str], Field(min_length=1, max_length=1000)]


class MappingTable(BaseModel):
    """Table of a mapping file; unknown keys are errors."""

    model_config = STRICT_TABLE


class SourceTable(MappingTable):
    """Source of signals: a file or a topic of a file, and its clock."""

    file: str
    """File name relative to the mapping file; a ROS 2 bag may be a folder."""
    topic: str | None = None
    """Topic of a ROS bag, MCAP or Rerun file."""
    time: str | None = None
    """Column with the times of the samples; `time` or `rate` is needed."""
    time_unit: Literal["s", "ms", "us", "ns", "min", "day"] | None = None
    """Unit of the column `time`; not needed if the file states it (ROS, C3D, Parquet)."""
    rate: Positive | None = None
    """Constant sampling rate, with the first sample at time 0 [Hz]. Default, without `time`: the
    rate of the recording."""
    steady: bool = False
    """The device samples at a constant rate and its time stamps jitter: times lie on the line
    through the stamps."""
    offset: Finite = 0.0
    """Time added to the times of the source, if its clock is behind the others' [s]."""
    skew: Annotated[float, Field(gt=-0.01, lt=0.01)] = 0.0
    """Relative error of the clock's rate: 1e-4 if the clock loses 100 ppm."""
    max_gap: Positive | None = None
    """Longest gap between samples that is interpolated [s]; default 0.1 s, or three samples."""
    drop_held: bool = False
    """Leave out samples in which no value changed: a slow device was read again."""

    @model_validator(mode="after")
    def _check_clock(self) -> SourceTable:
        """Check that a source has at most one clock, and a valid file name.

        Raises:
            ValueError: Both clocks are stated, a key belongs to the other clock, or the file name
                is not valid.
        """
        if self.time is not None and self.rate is not None:
            raise ValueError(
                "a source's clock is `time`, a column, or `rate` [Hz]; one of them"
            )
        if self.time is None and (self.time_unit or self.steady):
            raise ValueError("`time_unit` and `steady` are about a column `time`")
        if "\0" in self.file:
            raise ValueError("file is not a file name")
        return self


class GearTable(MappingTable):
    """Gear between motors and joints: motor positions are a matrix times joint positions.

    Power is equal on both sides.
    """

    ratio: Numbers | None = None
    """Gear ratio of each joint, with sign: turns of the motor for one turn of the joint."""
    matrix: Matrix | None = None
    """Matrix of coupled joints: row i gives the motion of motor i for each joint."""

    @model_validator(mode="after")
    def _check_invertible(self) -> GearTable:
        """Check that the gear has a ratio or an invertible square matrix.

        Raises:
            ValueError: The gear has both or neither, or the matrix is singular or not square.
        """
        if (self.ratio is None) == (self.matrix is None):
            raise ValueError("a gear has a `ratio` or a `matrix`, one of them")
        rows = self.matrix or []
        square = all(len(row) == len(rows) for row in rows)
        if not square or np.linalg.matrix_rank(self.motor_of_joint) < len(
            self.motor_of_joint
        ):
            raise ValueError(
                "a gear's matrix is square and can be inverted; no ratio is zero"
            )
        return self

    @property
    def motor_of_joint(self) -> Array:
        """Matrix from joint positions to motor positions, (n, n)."""
        rows = np.diag(self.ratio or []) if self.matrix is None else self.matrix
        return np.array(rows, dtype=np.float64)


class SignalTable(MappingTable):
    """Columns x that become a signal y of the joints: y = M (sign gain unit x) + offset."""

    source: str
    """Name of the source."""
    columns: Columns
    """Column names in the order of `joints`, or of the matrix's columns."""
    unit: str | list[str]
    """Unit of all columns, or unit of each column."""
    side: Literal["joint", "motor"] | None = None
    """Side of the gear on which the signal is measured; needed with a table [gear]."""
    gain: Finite | Numbers | None = None
    """Torque per unit of the measured quantity, for units of current and voltage [N m/A]."""
    gain_from: Literal["model", "plate"] | None = None
    """Origin of the gains, if they were estimated: the model file's masses, or a force plate."""
    sign: list[Sign] | None = None
    """Sign of each column: -1 where the column has the opposite sense."""
    matrix: Matrix | None = None
    """Matrix M: a row for each joint, a column for each column."""
    offset: Numbers | None = None
    """Offset added to each joint's signal [rad or m, N m or N, ...]."""
    sign_bit: Literal[0, 1024, 2048, 32768] | None = None
    """Smallest value with a sign bit: such values are negative, as loads of servos; 0 without a
    sign bit. Default: torques that seem to have a sign bit are refused."""
    delay: Finite = 0.0
    """Delay of the signal, besides the clock of its source: a filter in the drive [s]."""
    gravity: Literal["removed"] | None = None
    """"removed" if the driver subtracted the gravity torques of the model file; they are added
    again."""

    @property
    def units(self) -> list[str]:
        """Unit of each column."""
        return (
            self.unit
            if isinstance(self.unit, list)
            else [self.unit] * len(self.columns)
        )


class PlaceTable(MappingTable):
    """Pose of the sensor in the bedplate's frame."""

    xyz: Vector3
    """Origin of the sensor [m]."""
    rpy: Vector3
    """Roll, pitch, yaw [rad]: fixed axes x, then y, then z, as in URDF."""


class SixAxisTable(MappingTable):
    """Six columns that become a wrench."""

    source: str
    """Name of the source."""
    columns: Columns
    """Column names, forces before moments: six, or as many as the matrix has columns."""
    units: Annotated[list[str], Field(min_length=2, max_length=2)]
    """Units of forces and of moments, after the matrix if there is one."""
    sense: Literal["on_robot", "on_plate"]
    """Sense of the wrench: of the plate on the robot (upwards at rest), or of the robot on the
    plate. For a sensor in the robot: on the links beyond the sensor, or on the sensor."""
    place: PlaceTable | None = None
    """Pose of the sensor; default: the bedplate's frame, or the frame of the first link beyond the
    sensor."""
    matrix: Matrix | None = None
    """Calibration matrix of six rows, from the columns to forces and moments."""
    delay: Finite = 0.0
    """Delay of the signal, besides the clock of its source [s]."""


class ForceSensorTable(SixAxisTable):
    """Six columns that become the wrench of a force sensor in the robot.

    Its table is [sensors.NAME], with a free name for the sensor.
    """

    link: str = ""
    """First link beyond the sensor; default: the name of the sensor."""


class WrenchTable(SixAxisTable):
    """Six columns that become the bedplate's wrench."""

    tare: Vector6 | None = None
    """Share of the recorded wrench that is not the robot's, in the bedplate's frame [N, N m]; zeros
    for a plate that was zeroed with the pedestal on it. Default: the wrench of the model's
    pedestal."""
    pedestal: Literal["removed", "included"] | NotNegative | None = None
    """Content of the reading besides the robot: nothing, the model's pedestal (the default), or a
    mass with its centre above the bedplate's origin [kg]. Beside a `tare`, which contains the
    pedestal, it can only be removed."""

    def static_wrench(self, gravity: Sequence[float] | None) -> Array | None:
        """Share of the wrench on the robot that other bodies cause, (6,) [N, N m].

        It is in the bedplate's frame, about its origin. None stands for the wrench of the model's
        pedestal.

        Args:
            gravity: Gravity in the bedplate's frame, (3,) [m/s^2]; None for gravity along -z.
        """
        if self.tare is not None:
            return np.array(self.tare)
        if self.pedestal is None or self.pedestal == "included":
            return None
        mass = 0.0 if self.pedestal == "removed" else self.pedestal
        return np.append(
            -mass * np.array(gravity or GRAVITY_BY_MOUNTING["level"]), np.zeros(3)
        )


class BaseTable(MappingTable):
    """Measured pose of a moving base: root link's frame in the ground's frame."""

    source: str
    """Name of the source."""
    position: Annotated[list[str], Field(min_length=3, max_length=3)]
    """Columns of the base's position, along the ground's axes."""
    unit: str
    """Unit of the position."""
    quaternion: Annotated[list[str], Field(min_length=4, max_length=4)]
    """Columns of the orientation's quaternion: w, x, y, z, in this order in the mapping."""
    delay: Finite = 0.0
    """Delay of the pose, besides the clock of its source [s]."""

    @property
    def columns(self) -> list[str]:
        """Columns of position and quaternion."""
        return [*self.position, *self.quaternion]


AnyTable = SignalTable | SixAxisTable | BaseTable


class Mapping(MappingTable):
    """Content of a mapping file."""

    rate: Positive
    """Rate of the recording [Hz]."""
    joints: Annotated[list[Name], Field(min_length=1, max_length=1000)]
    """Joint names of the model file, in the order of the columns."""
    start: NotNegative = 0.0
    """Time omitted at the beginning of the interval that all sources cover [s]."""
    stop: Positive | None = None
    """End of the recording after the beginning of that interval [s]; default: the end of the
    interval."""
    lock: Annotated[dict[Name, Finite], Field(max_length=1000)] = {}
    """Joints of the model file without columns, and their constant positions [rad or m]."""
    gravity: Annotated[Vector3, BeforeValidator(parse_gravity)] | None = None
    """Gravity (gx, gy, gz) in the bedplate frame [m/s^2], or the mounting: "level", "ceiling",
    "wall +x", "wall -x", "wall +y", "wall -y", "none"; default: the model file's."""
    sources: Annotated[dict[str, SourceTable], Field(min_length=1, max_length=100)]
    """Sources by free names."""
    errors: Annotated[dict[Name, Finite], Field(max_length=1000)] = {}
    """Known sensor errors that are removed: coefficients by name, as `"bias/Fx" = 2.0` [N]
    (docs/instruments.md). Errors that change in time are stated for the middle of the recording."""
    gear: GearTable | None = None
    position: SignalTable
    velocity: SignalTable | None = None
    acceleration: SignalTable | None = None
    torque: SignalTable | None = None
    temperature: SignalTable | None = None
    """Temperatures of the joints' drives."""
    wrench: WrenchTable | None = None
    plates: Annotated[dict[str, WrenchTable], Field(max_length=100)] = {}
    """Several plates in place of [wrench], by free names: the wrench is their sum."""
    sensors: Annotated[dict[Name, ForceSensorTable], Field(max_length=100)] = {}
    """Force sensors in the robot, by free names."""
    base: BaseTable | None = None
    """Pose of the robot's base, if it moves (`robot.base = "measured"`)."""

    @property
    def wrench_and_base_tables(self) -> dict[str, AnyTable]:
        """Tables of signals other than joint signals: wrench, plates.NAME, sensors.NAME, base."""
        tables: dict[str, AnyTable | None] = {
            f"plates.{k}": t for k, t in self.plates.items()
        }
        tables |= {f"sensors.{k}": table for k, table in self.sensors.items()}
        tables |= {"wrench": self.wrench, "base": self.base}
        return {label: table for label, table in tables.items() if table is not None}

    @property
    def joint_signal_tables(self) -> dict[str, SignalTable]:
        """Tables of signals that are measured at each joint, keyed by signal."""
        tables = {
            kind: getattr(self, kind) for kind in (*JOINT_QUANTITIES, "temperature")
        }
        return {kind: table for kind, table in tables.items() if table is not None}

    @property
    def all_signal_tables(self) -> dict[str, AnyTable]:
        """Tables of all signals, keyed by label in the file."""
        return {**self.joint_signal_tables, **self.wrench_and_base_tables}

    @model_validator(mode="after")
    def _check_consistency(self) -> Mapping:
        """Check that the tables agree in joints, lengths, units and sources.

        Raises:
            ValueError: Tables disagree, or a signal is missing.
        """
        n = len(self.joints)
        if len(set(self.joints)) < n:
            raise ValueError("joints: a name is there twice")
        if repeated := set(self.lock) & set(self.joints):
            raise ValueError(
                f"lock: '{min(repeated)}' is among the joints that have columns"
            )
        if (
            self.torque is None
            and self.wrench is None
            and not (self.plates or self.sensors)
        ):
            raise ValueError("a recording has a [torque], a [wrench] or [sensors.NAME]")
        if self.wrench is not None and self.plates:
            raise ValueError("say [wrench], or all plates under [plates], not both")
        if self.stop is not None and self.stop <= self.start:
            raise ValueError("stop comes after start")
        if self.gear is not None and len(self.gear.motor_of_joint) != n:
            raise ValueError(
                f"gear: {len(self.gear.motor_of_joint)} motors, {n} joints"
            )
        for kind, table in self.joint_signal_tables.items():
            _check_signal(kind, table, n, self.gear is not None)
        for plate in self.wrench_and_base_tables.values():
            if isinstance(plate, SixAxisTable):
                _check_wrench(plate)
        if self.base is not None and not is_length_unit(self.base.unit):
            raise ValueError(
                f"base.unit: '{self.base.unit}' is no length (m, cm, mm, inch)"
            )
        for label, signal_table in self.all_signal_tables.items():
            if signal_table.source not in self.sources:
                known = ", ".join(self.sources)
                raise ValueError(
                    f"{label}.source: there is no source '{signal_table.source}' ({known})"
                )
        return self


def read_mapping(path: Path) -> Mapping:
    """Read a mapping file.

    Args:
        path: TOML file.

    Raises:
        ExperimentError: The file cannot be read or is not valid; the message has one line.
    """
    content = read_toml(path, "mapping")
    empty = [*empty_keys(content)]
    if empty:
        raise ExperimentError(
            f"{path}: fill in what is empty: {', '.join(dict.fromkeys(empty))}"
        )
    return validate_tables(Mapping, content, str(path))


def empty_keys(content: object, place: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield dotted names of keys with empty values, as in a draft mapping file.

    Args:
        content: Content of the file or of a table in it.
        place: Keys that lead to the table.
    """
    if isinstance(content, dict):
        for key, value in content.items():
            yield from empty_keys(value, (*place, str(key)))
    elif isinstance(content, list):
        for value in content:
            yield from empty_keys(value, place)
    elif content == "":
        yield ".".join(place)


def source_paths(path: Path) -> list[Path]:
    """Paths of the source files of a mapping file.

    Args:
        path: Mapping file.

    Raises:
        ExperimentError: The mapping is not valid.
    """
    return [path.parent / source.file for source in read_mapping(path).sources.values()]


def _check_signal(kind: str, table: SignalTable, joints: int, geared: bool) -> None:
    """Check lengths of lists and units in a signal's table.

    Args:
        kind: Signal.
        table: Table of the signal.
        joints: Number of joints.
        geared: True if the mapping has a table [gear].

    Raises:
        ValueError: Lengths or units do not fit.
    """
    columns, rows = len(table.columns), joints
    lists: tuple[tuple[str, Sequence[object] | None, int], ...] = (
        ("unit", table.units, columns),
        ("sign", table.sign, columns),
        ("gain", table.gain if isinstance(table.gain, list) else None, columns),
        ("offset", table.offset, rows),
        ("matrix", table.matrix, rows),
    )
    for key, values, length in lists:
        if values is not None and len(values) != length:
            raise ValueError(f"{kind}.{key}: {len(values)} given, {length} wanted")
    for each in table.units:
        check_unit(kind, each, with_gain=table.gain is not None)
    if table.matrix is not None and any(len(row) != columns for row in table.matrix):
        raise ValueError(
            f"{kind}.matrix: a row has as many numbers as there are columns"
        )
    if table.matrix is None and columns != joints:
        raise ValueError(
            f"[{kind}] columns: {count_with_noun(columns, 'column')} for "
            f"{count_with_noun(joints, 'joint')}: say the "
            "others, or take joints without columns out of all lists and into [lock]"
        )
    if (geared and kind != "temperature") != (table.side is not None):
        message = (
            "say `side`: joint or motor" if geared else "`side` needs a table [gear]"
        )
        raise ValueError(f"{kind}.side: {message}")


def _check_wrench(table: SixAxisTable) -> None:
    """Check lengths of lists and units in the table of a wrench.

    Raises:
        ValueError: Lengths or units do not fit, or both a tare and a pedestal are stated.
    """
    check_unit("force", table.units[0])
    check_unit("moment", table.units[1])
    if (
        isinstance(table, WrenchTable)
        and table.tare
        and table.pedestal not in (None, "removed")
    ):
        raise ValueError(
            "wrench: a tare is all that is not the robot's: no pedestal beside it"
        )
    columns = len(table.columns)
    if table.matrix is None and columns != 6:
        raise ValueError(
            f"wrench.columns: {count_with_noun(columns, 'column')}, 6 wanted, "
            "or a matrix of six rows"
        )
    if table.matrix is not None and (
        len(table.matrix) != 6 or any(len(row) != columns for row in table.matrix)
    ):
        raise ValueError(f"wrench.matrix: six rows of {columns} numbers are wanted")
