"""The mapping file: how the columns of foreign files become a recording.

TOML. What cannot be guessed has no default: units, the sense of the wrench, each source's
clock, the rate of the recording. A key that is not known is an error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    model_validator,
)

from testbed.core.base.arrays import Array
from testbed.core.base.errors import ExperimentError, plural
from testbed.core.base.toml_text import (
    KNOWN_KEYS,
    Finite,
    NotNegative,
    Positive,
    checked,
    read_toml,
)
from testbed.core.robot.gravity import MOUNTINGS, gravity_of
from testbed.importing.foreign_table import KINDS, check_unit, slides


def _printable(name: str) -> str:
    if not name.isprintable():
        raise ValueError("it is no name")
    return name


Numbers = Annotated[list[Finite], Field(min_length=1, max_length=1000)]
Rows = Annotated[list[Numbers], Field(min_length=1, max_length=1000)]
Three = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Six = Annotated[list[Finite], Field(min_length=6, max_length=6)]
Name = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_printable)]
Sign = Literal[1, -1]
Columns = Annotated[list[str], Field(min_length=1, max_length=1000)]


class MappingTable(BaseModel):
    """A table whose keys are all known."""

    model_config = KNOWN_KEYS


class SourceTable(MappingTable):
    """A file, or a topic of it, and its clock."""

    file: str
    """Relative to the mapping file; a ROS 2 bag may be a folder."""
    topic: str | None = None
    """Of a ROS bag."""
    time: str | None = None
    """Column that holds the samples' times; this or `rate`."""
    time_unit: Literal["s", "ms", "us", "ns", "min", "day"] | None = None
    """Of that column; may be left out where the file says it (ROS, C3D, Parquet)."""
    rate: Positive | None = None
    """Samples a second, at a constant rate [Hz]; the first one is at time 0. Default, without
    `time`, the recording's."""
    steady: bool = False
    """The device samples at a constant rate and its stamps jitter: times are those of the line
    through the stamps."""
    offset: Finite = 0.0
    """Added to the source's times [s]: where its clock is behind the others'."""
    skew: Annotated[float, Field(gt=-0.01, lt=0.01)] = 0.0
    """How much more time passes than its clock says, relative: 1e-4 where it loses 100 ppm."""
    max_gap: Positive | None = None
    """Longest time between samples that is bridged [s]; default 0.1 s, or three samples."""
    drop_held: bool = False
    """Samples in which nothing changed are a slow device's, read again: leave them out."""

    @model_validator(mode="after")
    def _has_a_clock(self) -> SourceTable:
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
    """Between motors and joints: motor = matrix x joint in position; power is the same."""

    ratio: Numbers | None = None
    """Turns of the motor for one of the joint, with its sign, joint by joint."""
    matrix: Rows | None = None
    """The same where joints are coupled: row i says how motor i turns with each joint."""

    @model_validator(mode="after")
    def _can_be_undone(self) -> GearTable:
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
        """(n, n): motor positions of joint positions."""
        rows = np.diag(self.ratio or []) if self.matrix is None else self.matrix
        return np.array(rows, dtype=np.float64)


class SignalTable(MappingTable):
    """Columns that become a signal of the joints: y = M (sign gain unit x) + offset."""

    source: str
    """Of which source."""
    columns: Columns
    """In the order of `joints`, or of the matrix's columns."""
    unit: str | list[str]
    """Of all columns, or column by column."""
    side: Literal["joint", "motor"] | None = None
    """Of the gear; must be said where there is a table [gear]."""
    gain: Finite | Numbers | None = None
    """Torque of a unit of what was measured, for units of current and voltage [N m/A]."""
    gain_from: Literal["model", "plate"] | None = None
    """What the gains were computed from, if not known: the model file's masses, or a plate."""
    sign: list[Sign] | None = None
    """Of each column: -1 where it counts the other way."""
    matrix: Rows | None = None
    """M: a row a joint, a column a column."""
    offset: Numbers | None = None
    """Added to each joint [rad or m, N m or N, ...]."""
    sign_bit: Literal[0, 1024, 2048, 32768] | None = None
    """From this number on the columns count down from zero, as servos' loads; 0 where they do not.
    Default: torques that seem to have such a bit are refused."""
    delay: Finite = 0.0
    """How late the signal is, besides its source's clock: a filter in the drive [s]."""
    gravity: Literal["removed"] | None = None
    """Of torques: whether the driver has subtracted the model file's gravity, which is added."""

    @property
    def units(self) -> list[str]:
        """Unit of each column."""
        return (
            self.unit
            if isinstance(self.unit, list)
            else [self.unit] * len(self.columns)
        )


class PlaceTable(MappingTable):
    """Where the sensor is and how it is turned, in the bedplate's frame."""

    xyz: Three
    """Its origin [m]."""
    rpy: Three
    """Roll, pitch, yaw [rad]: fixed axes x, then y, then z, as in URDF."""


class SixAxisTable(MappingTable):
    """Six columns that become a wrench."""

    source: str
    """Of which source."""
    columns: Columns
    """Force, then moment: six, or as many as the matrix has columns."""
    units: Annotated[list[str], Field(min_length=2, max_length=2)]
    """Of forces and of moments, after the matrix if there is one."""
    sense: Literal["on_robot", "on_plate"]
    """Whether the sensor shows what the plate does to the robot (at rest: upwards), or what the
    robot does to the plate. Of a sensor in the robot: what it does to the links beyond it."""
    place: PlaceTable | None = None
    """Of the sensor; default the bedplate's frame, or that of the first link beyond it."""
    matrix: Rows | None = None
    """Six rows: from the columns to forces and moments, as of a sensor's calibration."""
    delay: Finite = 0.0
    """How late the signal is, besides its source's clock [s]."""


class ForceSensorTable(SixAxisTable):
    """Six columns that become the wrench of a force sensor in the robot, by a name of your own."""

    link: str = ""
    """The first link beyond it; default the sensor's name."""


class WrenchTable(SixAxisTable):
    """Six columns that become the bedplate's wrench."""

    tare: Six | None = None
    """What of the recording's wrench is not the robot's, in the bedplate's frame [N, N m]; zeros
    for a plate that was zeroed with the pedestal on it. Default: the model's pedestal."""
    pedestal: Literal["removed", "included"] | NotNegative | None = None
    """What the reading contains of what stands on the plate besides the robot: nothing, the model's
    pedestal (the default), or so much, with its centre above the bedplate's origin [kg]. Beside a
    `tare`, which is all that is not the robot's, it can only be removed."""

    def static(self, gravity: Sequence[float] | None) -> Array | None:
        """What of the reading is not the robot's, (6,) [N, N m]; None for the model's pedestal.

        Args:
            gravity: (3,) [m/s^2]; None for the vertical.
        """
        if self.tare is not None:
            return np.array(self.tare)
        if self.pedestal is None or self.pedestal == "included":
            return None
        mass = 0.0 if self.pedestal == "removed" else self.pedestal
        return np.append(-mass * np.array(gravity or MOUNTINGS["level"]), np.zeros(3))


class BaseTable(MappingTable):
    """Where a base that moves is: the frame of the model's root link on the ground."""

    source: str
    """Of which source."""
    position: Annotated[list[str], Field(min_length=3, max_length=3)]
    """Columns of its place, along the ground's axes."""
    unit: str
    """Of these."""
    quaternion: Annotated[list[str], Field(min_length=4, max_length=4)]
    """Columns of its turn: w, x, y, z, in this order whatever the file's is."""
    delay: Finite = 0.0
    """How late the pose is, besides its source's clock [s]."""

    @property
    def columns(self) -> list[str]:
        """All seven."""
        return [*self.position, *self.quaternion]


AnyTable = SignalTable | SixAxisTable | BaseTable


class Mapping(MappingTable):
    """All that a mapping file says."""

    rate: Positive
    """Of the recording [Hz]."""
    joints: Annotated[list[Name], Field(min_length=1, max_length=1000)]
    """Names in the model file, in the order of the columns below."""
    start: NotNegative = 0.0
    """Cut so much from the beginning of what all sources cover [s]."""
    stop: Positive | None = None
    """End so long after that beginning [s]; default where the first source ends."""
    lock: Annotated[dict[Name, Finite], Field(max_length=1000)] = {}
    """Joints of the model file without columns, and where they are held [rad or m]."""
    gravity: Annotated[Three, BeforeValidator(gravity_of)] | None = None
    """(gx, gy, gz) [m/s^2], bedplate frame, or how it is mounted: "level", "ceiling", "wall +x",
    "wall -x", "wall +y", "wall -y", "none"; default the model file's."""
    sources: Annotated[dict[str, SourceTable], Field(min_length=1, max_length=100)]
    """By names of your own."""
    errors: Annotated[dict[Name, Finite], Field(max_length=1000)] = {}
    """Known errors of the sensors, taken back: coefficients by name, as `"bias/Fx" = 2.0` [N]
    (docs/instruments.md). Of those that change in time, from the middle of the recording on."""
    gear: GearTable | None = None
    position: SignalTable
    velocity: SignalTable | None = None
    acceleration: SignalTable | None = None
    torque: SignalTable | None = None
    temperature: SignalTable | None = None
    """Of the joints' drives."""
    wrench: WrenchTable | None = None
    plates: Annotated[dict[str, WrenchTable], Field(max_length=100)] = {}
    """Several plates in place of [wrench], by names of your own: the wrench is their sum."""
    sensors: Annotated[dict[Name, ForceSensorTable], Field(max_length=100)] = {}
    """Force sensors in the robot, by names of your own."""
    base: BaseTable | None = None
    """Where the robot's base is, if it moves (`robot.base = "measured"`)."""

    @property
    def others(self) -> dict[str, AnyTable]:
        """What is measured besides joint by joint: wrench, plates.NAME, sensors.NAME, base."""
        found: dict[str, AnyTable | None] = {
            f"plates.{k}": t for k, t in self.plates.items()
        }
        found |= {f"sensors.{k}": table for k, table in self.sensors.items()}
        found |= {"wrench": self.wrench, "base": self.base}
        return {label: table for label, table in found.items() if table is not None}

    @property
    def signals(self) -> dict[str, SignalTable]:
        """What is measured joint by joint, by its kind."""
        found = {kind: getattr(self, kind) for kind in (*KINDS, "temperature")}
        return {kind: table for kind, table in found.items() if table is not None}

    @property
    def tables(self) -> dict[str, AnyTable]:
        """All that is measured, by its label in the file."""
        return {**self.signals, **self.others}

    @model_validator(mode="after")
    def _fits_together(self) -> Mapping:
        n = len(self.joints)
        if len(set(self.joints)) < n:
            raise ValueError("joints: a name is there twice")
        if twice := set(self.lock) & set(self.joints):
            raise ValueError(
                f"lock: '{min(twice)}' is among the joints that have columns"
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
        for kind, table in self.signals.items():
            _check_signal(kind, table, n, self.gear is not None)
        for plate in self.others.values():
            if isinstance(plate, SixAxisTable):
                _check_wrench(plate)
        if self.base is not None and not slides(self.base.unit):
            raise ValueError(
                f"base.unit: '{self.base.unit}' is no length (m, cm, mm, inch)"
            )
        for label, found in self.tables.items():
            if found.source not in self.sources:
                known = ", ".join(self.sources)
                raise ValueError(
                    f"{label}.source: there is no source '{found.source}' ({known})"
                )
        return self


def read_mapping(path: Path) -> Mapping:
    """Read a mapping file.

    Args:
        path: The TOML file.

    Raises:
        ExperimentError: It cannot be read, or says what is not understood, in one line.
    """
    content = read_toml(path, "mapping")
    empty = [*empty_keys(content)]
    if empty:
        raise ExperimentError(
            f"{path}: fill in what is empty: {', '.join(dict.fromkeys(empty))}"
        )
    return checked(Mapping, content, str(path))


def empty_keys(content: object, place: tuple[str, ...] = ()) -> Iterator[str]:
    """Dotted names of keys that are still empty, as a mapping that was guessed leaves them.

    Args:
        content: Of the file.
        place: Of the content in it.
    """
    if isinstance(content, dict):
        for key, value in content.items():
            yield from empty_keys(value, (*place, str(key)))
    elif isinstance(content, list):
        for value in content:
            yield from empty_keys(value, place)
    elif content == "":
        yield ".".join(place)


def sources(path: Path) -> list[Path]:
    """The files that a mapping file names.

    Raises:
        ExperimentError: The mapping is not understood.
    """
    return [path.parent / source.file for source in read_mapping(path).sources.values()]


def _check_signal(kind: str, table: SignalTable, joints: int, geared: bool) -> None:
    """Whether a signal's lists are of one length and its units fit.

    Raises:
        ValueError: They do not.
    """
    columns, rows = len(table.columns), joints
    lists: tuple[tuple[str, Sequence[object] | None, int], ...] = (
        ("unit", table.units, columns),
        ("sign", table.sign, columns),
        ("gain", table.gain if isinstance(table.gain, list) else None, columns),
        ("offset", table.offset, rows),
        ("matrix", table.matrix, rows),
    )
    for what, given, wanted in lists:
        if given is not None and len(given) != wanted:
            raise ValueError(f"{kind}.{what}: {len(given)} given, {wanted} wanted")
    for each in table.units:
        check_unit(kind, each, gained=table.gain is not None)
    if table.matrix is not None and any(len(row) != columns for row in table.matrix):
        raise ValueError(
            f"{kind}.matrix: a row has as many numbers as there are columns"
        )
    if table.matrix is None and columns != joints:
        raise ValueError(
            f"[{kind}] columns: {plural(columns, 'column')} for {plural(joints, 'joint')}: say the "
            "others, or take joints without columns out of all lists and into [lock]"
        )
    if (geared and kind != "temperature") != (table.side is not None):
        said = "say `side`: joint or motor" if geared else "`side` needs a table [gear]"
        raise ValueError(f"{kind}.side: {said}")


def _check_wrench(table: SixAxisTable) -> None:
    """Whether the wrench's lists are of one length and its units fit.

    Raises:
        ValueError: They do not.
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
            f"wrench.columns: {plural(columns, 'column')}, 6 wanted, or a matrix of six rows"
        )
    if table.matrix is not None and (
        len(table.matrix) != 6 or any(len(row) != columns for row in table.matrix)
    ):
        raise ValueError(f"wrench.matrix: six rows of {columns} numbers are wanted")
